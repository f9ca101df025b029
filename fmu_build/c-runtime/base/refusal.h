/* Sentences that say why a call was refused. */
#ifndef FLEXFMU_REFUSAL_H
#define FLEXFMU_REFUSAL_H

#include "model.h"

#define FLEX_MESSAGE_SIZE 512

/* writes a sentence into a message of FLEX_MESSAGE_SIZE characters; returns 1, the result of what is refused */
int flex_refuse(char *message, const char *format, ...);

/* 0 if a variable may have the value: finite and within its limits */
int flex_refuse_value(char *message, const flex_variable *variable, double value);

/* 0 if an input is finite at a time: its derivatives may have carried it beyond all numbers */
int flex_refuse_input(char *message, const flex_variable *variable, double time, double value);

/* 0 if there are that many real variables */
int flex_refuse_reference(char *message, unsigned index, unsigned count);

/* 0 if the derivative of an input may have that order and value */
int flex_refuse_derivative(char *message, const char *name, int order, int highest, double value);

#endif

#include "refusal.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>

int flex_refuse(char *message, const char *format, ...) {
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(message, FLEX_MESSAGE_SIZE, format, arguments);
  va_end(arguments);
  return 1;
}

int flex_refuse_value(char *message, const flex_variable *variable, double value) {
  const char *name = variable->name, *unit = variable->unit;
  if (!isfinite(value)) return flex_refuse(message, "%s must be a finite number in %s, got %g", name, unit, value);
  if (value >= variable->minimum && value <= variable->maximum) return 0;
  return flex_refuse(message, "%s must be in %.6g .. %.6g %s, got %.6g", name, variable->minimum, variable->maximum, unit,
                     value);
}

int flex_refuse_input(char *message, const flex_variable *variable, double time, double value) {
  if (isfinite(value)) return 0;
  return flex_refuse(message, "input %s is %g at %.9g s; its derivatives have carried it there, set it again", variable->name,
                     value, time);
}

int flex_refuse_reference(char *message, unsigned index, unsigned count) {
  if (index < count) return 0;
  return flex_refuse(message, "value reference %u of a real variable is unknown; there are %u", index, count);
}

int flex_refuse_derivative(char *message, const char *name, int order, int highest, double value) {
  if (order < 1 || order > highest)
    return flex_refuse(message, "derivatives of %s must be of order 1 to %d, got order %d", name, highest, order);
  if (isfinite(value)) return 0;
  return flex_refuse(message, "derivative %d of %s must be a finite number, got %g", order, name, value);
}

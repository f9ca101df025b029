/* Asks for the oldest version of a C library function that a 64-bit x86 Linux has, so that a binary that was linked
   on a new system runs on old ones too.
   Included in front of every file by the build; a build without it is as good on the machine that made it. */
#ifndef FLEXFMU_OLD_GLIBC_H
#define FLEXFMU_OLD_GLIBC_H

#include <limits.h> /* any header of the C library says which one it is */

#if defined(__GLIBC__) && defined(__x86_64__) && defined(__LP64__)
__asm__(".symver memcpy,memcpy@GLIBC_2.2.5");
#endif

#endif

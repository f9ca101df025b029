/* Functions that a library exports; and data that files of the runtime share with each other alone: addressed directly, not
 * through a table of offsets. Zig's linker leaves entries of that table undefined for ARM Macs, and so no two of its libraries are equal. */
#ifndef FLEXFMU_PRIVATE_H
#define FLEXFMU_PRIVATE_H

#if defined(__GNUC__) && !defined(_WIN32)
#define FLEX_PRIVATE extern __attribute__((visibility("hidden")))
#else
#define FLEX_PRIVATE extern
#endif

#if defined(_WIN32)
#define FLEX_EXPORTED __declspec(dllexport)
#else
#define FLEX_EXPORTED __attribute__((visibility("default")))
#endif

#endif

/* What all headers of gscore share: exported functions, statuses, instruction sets, threads. */
#pragma once

#include <stdint.h>

#ifdef __cplusplus
#define GS_C extern "C"
#else
#define GS_C extern
#endif
#if defined(_WIN32)
#if defined(GSCORE_BUILD)
#define GS_API GS_C __declspec(dllexport)
#else
#define GS_API GS_C __declspec(dllimport)
#endif
#else
#define GS_API GS_C __attribute__((visibility("default")))
#endif

/* Changes whenever a struct, a signature or a value of these headers changes. */
#define GS_ABI_VERSION 18

/* Maximum number of threads of a call. */
#define GS_THREADS_MAX 1024

typedef enum gs_status {
    GS_OK = 0,
    GS_BAD_ARGUMENT = 1,  /* an invalid size, pointer or option */
    GS_OUT_OF_MEMORY = 2, /* an allocation failed; the gs_raster stays usable */
    GS_CANCELLED = 3,     /* *cancel became non-zero */
    GS_TOO_MANY = 4,      /* more than 2^31 - 1 (list tile, splat) entries */
    GS_UNSUPPORTED = 5,   /* an instruction set not available here, or gradients of parallel rays */
    GS_INTERNAL = 6       /* an error in the library */
} gs_status;

/* GS_ABI_VERSION of the header with which the library was built. */
GS_API int32_t gs_abi_version(void);
/* Message of the last failure on this thread, UTF-8, valid until the next call on this thread. */
GS_API const char *gs_last_error(void);

/* Available instruction sets, best first, comma-separated: those of "avx512,avx2,neon,scalar" that were compiled in and
 * that this CPU supports. "scalar" is the same code for the baseline instruction set. */
GS_API const char *gs_isas(void);
/* The instruction set in use: that in the environment variable GSCORE_ISA if it is available, else the best. */
GS_API const char *gs_isa(void);
/* Switch the instruction set, not while another thread rasterizes. GS_UNSUPPORTED if it is not available. */
GS_API gs_status gs_set_isa(const char *name);
/* Number of threads for an option of 0: the environment variable GSCORE_THREADS, read once, or the number of usable
 * cores if that is unset, empty or 0. If its value is not an integer from 0 to GS_THREADS_MAX, this returns 0 with a
 * message in gs_last_error(), and calls with 0 threads fail. */
GS_API int32_t gs_default_threads(void);

/* gscore: differentiable rasterization of 3D Gaussians on the CPU, as a plain C interface.
 *
 * Its headers are the manual of the library. Conventions:
 *  - All arrays are C-contiguous, float32 unless stated otherwise, and owned by the caller. Output arrays are written
 *    completely. N is the number of splats, H and W the image size in pixels.
 *  - Pixel centres are at +0.5. Cameras use OpenCV axes (+x right, +y down, +z forward); `viewmat` maps world to
 *    camera, row-major, for column vectors.
 *  - Functions return a gs_status unless declared otherwise. On any status but GS_OK, gs_last_error() on the same
 *    thread returns the message, and outputs are unspecified.
 *  - One thread at a time may use a gs_raster; different threads may use different ones. A forked process may use those
 *    that no thread of its parent was using at the fork.
 *  - No input value crashes the library: splats with NaN, infinities or a colour above 1e9 are culled.
 *  - Results are bit-identical for any number of threads.
 *
 * The mathematics is that of Kerbl et al. 2023 (3D Gaussian Splatting) and Zwicker et al. 2001 (EWA splatting), with
 * the constants of csrc/shared/constants.h.
 */
#pragma once

#include "gscore/base.h"
#include "gscore/light.h"
#include "gscore/loss.h"
#include "gscore/matching.h"
#include "gscore/mesh.h"
#include "gscore/optimizer.h"
#include "gscore/random.h"
#include "gscore/raster.h"
#include "gscore/stereo.h"

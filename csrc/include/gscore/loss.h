/* Loss between a rendered picture and a photo: L1 and SSIM, with masks. */
#pragma once

#include "raster.h"

/* Mask modes of gs_image_loss. */
enum {
    GS_MASK_NONE = 0,
    GS_MASK_COMPOSITE = 1, /* target = photo * mask + background * (1 - mask) */
    GS_MASK_IGNORE = 2     /* image and photo are both multiplied by the mask */
};

/* loss = (1 - ssim_weight) * mean|x - y| + ssim_weight * (1 - mean SSIM(x, y)), with x the image, y the target.
 * SSIM (Wang et al. 2004): Gaussian window of 11 px, sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2, per channel.
 * With a gain g, x is the image, a neutral sRGB picture, with the photo's exposure, before a mask multiplies it:
 * (image + o) g - o, o = GS_EXPOSURE_OFFSET, and image g^2.4 below the value where these lines meet. Where the photo is
 * white (255) and x is brighter, x counts as white and receives no gradient. */
typedef struct gs_loss_args {
    int32_t width, height;
    const float *image;    /* [H, W, 3] */
    const uint8_t *target; /* [H, W, 3] */
    const uint8_t *mask;   /* [H, W]; null with GS_MASK_NONE */
    int32_t mask_mode;     /* GS_MASK_* */
    float background[3];   /* RGB, for GS_MASK_COMPOSITE */
    float ssim_weight;     /* 0 to 1 */
    int32_t threads;       /* 0: gs_default_threads() */
    const float *gain;     /* [3] per channel, above 0 and finite; null: no gain */
} gs_loss_args;

typedef struct gs_loss_result {
    double loss, l1, ssim, mse; /* mse of x against y, both as in the loss */
    double v_log_gain[3];       /* derivative of the loss in ln gain; 0 without gain or v_image */
} gs_loss_result;

/* Compute the loss and, unless v_image is null, its gradient [H, W, 3] with respect to the image. Uses the buffers of
 * the gs_raster; its forward state stays valid. */
GS_API gs_status gs_image_loss(gs_raster *raster, const gs_loss_args *args, gs_loss_result *result, float *v_image);

/* A convolution of a picture with the Gaussian of a 2D covariance, normalised inside the picture. */
typedef struct gs_blur_args {
    int32_t width, height;
    const float *image;  /* [H, W, 3] */
    float covariance[3]; /* xx, xy, yy, px^2; positive semidefinite, at most GS_BLUR_MAX */
    int32_t adjoint; /* 1: the transposed operator: from gradients in the blurred picture to those in the sharp one */
    int32_t threads; /* 0: gs_default_threads() */
} gs_blur_args;

/* Blur a picture; `blurred` [H, W, 3] is another array. The result does not depend on the number of threads. */
GS_API gs_status gs_blur_image(const gs_blur_args *args, float *blurred);

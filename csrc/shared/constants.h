/* Constants of the splat pipeline, for C, C++, GLSL and, through tools/build/shared_constants.py, Python and the shaders
 * of the page and the add-on. Nothing but #define lines, each with its reason. A list is for an initialiser:
 * float a[5] = {GS_SH_C2} in C, float a[5] = float[5](GS_SH_C2) in GLSL. */
#ifndef GS_SHARED_CONSTANTS_H
#define GS_SHARED_CONSTANTS_H

/* Minimum alpha with which a splat contributes to a pixel: less is invisible in 8 bits (Kerbl et al. 2023). */
#define GS_ALPHA_MIN (1.0f / 255.0f)
/* Base 2 logarithm of GS_ALPHA_MIN: exponents are compared with it before they are evaluated. */
#define GS_LOG2_ALPHA_MIN (-7.99435343685886f)
/* Half the base 2 logarithm of e: exp(-d / 2) = exp2(-GS_HALF_LOG2E d), and exp2 is cheaper. */
#define GS_HALF_LOG2E 0.72134752044448170f
/* Maximum of alpha, so that the backward pass can divide by 1 - alpha; a clamped alpha passes no gradient. */
#define GS_ALPHA_MAX 0.99f
/* A pixel is complete when the next splat would reduce its transmittance to this or less; that splat is not blended.
 * What is behind could change no 8-bit value by a hundredth of a step. */
#define GS_TRANSMITTANCE_MIN 1e-4f
/* Usual value added to the diagonal of the 2D covariance, px^2: a low-pass filter of about a pixel (Zwicker et al. 2001),
 * with the value of 3DGS, so that models of other programs look alike. */
#define GS_EPS2D 0.3f
/* Minimum opacity factor of the antialiasing compensation, so that splats much thinner than a pixel keep a gradient. */
#define GS_COMPENSATION_MIN 0.005f
/* x / z and y / z in the projection's Jacobian are clamped to the picture plus this share of its half-angle on each
 * side, because the linearisation degenerates far off screen (3DGS). */
#define GS_JACOBIAN_MARGIN 0.3f
/* Upper bound of the radius of a drawn splat in standard deviations: sqrt(2 ln 255) = 3.3290, rounded up. */
#define GS_REACH 3.34f
/* A splat is culled if no component of its quaternion has at least this magnitude: it has no direction. The rule is on
 * the largest component, because squares of such numbers are lost in float. */
#define GS_QUAT_MIN 1e-8f
/* Brighter splats are culled as invalid, because their gradients would overflow, or cancel those of other splats. */
#define GS_COLOR_MAX 1e9f
/* Side of the tiles in which drawing can be switched off, px. */
#define GS_TILE 16

/* Factors of the real spherical harmonics: roots of rational multiples of 1/pi (Sloan 2013, "Efficient spherical harmonic
 * evaluation"). Signs and order of 3DGS: bands ascending, within a band m = -l..l; degree 1 is -y, z, -x. */
#define GS_SH_C0 0.28209479177387814f
#define GS_SH_C1 0.4886025119029199f
/* Of xy, yz, 2zz-xx-yy, xz, xx-yy. */
#define GS_SH_C2                                                                                                       \
    1.0925484305920792f, -1.0925484305920792f, 0.31539156525252005f, -1.0925484305920792f, 0.5462742152960396f
/* Of y(3xx-yy), xyz, y(4zz-xx-yy), z(2zz-3xx-3yy), x(4zz-xx-yy), z(xx-yy), x(xx-3yy). */
#define GS_SH_C3                                                                                                       \
    -0.5900435899266435f, 2.890611442640554f, -0.4570457994644658f, 0.3731763325901154f, -0.4570457994644658f,         \
        1.445305721320277f, -0.5900435899266435f
/* Of xy(xx-yy), yz(3xx-yy), xy(6zz-rr), yz(4zz-3rr), 8zzzz-24zzrr+3rrrr, xz(4zz-3rr), (xx-yy)(6zz-rr), xz(xx-3yy),
 * xxxx-6xxyy+yyyy, with rr = xx+yy. */
#define GS_SH_C4                                                                                                       \
    2.5033429417967046f, -1.7701307697799304f, 0.9461746957575601f, -0.6690465435572892f, 0.10578554691520431f,        \
        -0.6690465435572892f, 0.47308734787878004f, -1.7701307697799304f, 0.6258357354491761f

/* SSIM (Wang et al. 2004): width of its Gaussian window and standard deviation, px. */
#define GS_SSIM_WINDOW 11
#define GS_SSIM_SIGMA 1.5f
/* Weights of the window's centre and of the taps 1 to 5 px away, as float arithmetic gives them: the sum over all 11 is
 * 1. */
#define GS_SSIM_TAPS                                                                                                   \
    0.26601172486179436f, 0.21300553771125370f, 0.10936068950970002f, 0.036000773310661005f, 0.007598758135239183f,    \
        0.0010283801057925797f

/* Blur of a photo: reach of its weights in standard deviations, and largest variance along an axis, px^2. */
#define GS_BLUR_REACH 3.0f
#define GS_BLUR_MAX 4096.0f
/* Its constants for values in [0, 1] (equation 13). */
#define GS_SSIM_C1 (0.01f * 0.01f)
#define GS_SSIM_C2 (0.03f * 0.03f)

/* Offset and power of the sRGB curve, 1.055 L^(1/2.4) - 0.055 (IEC 61966-2-1), by which photos are exposed, see
 * csrc/src/exposure.h. */
#define GS_EXPOSURE_OFFSET 0.055f
#define GS_EXPOSURE_POWER 2.4f

/* Rows in a row that dropout leaves out together; rows are neighbours, because they are sorted along a Morton curve. */
#define GS_DROPOUT_ROWS 16

/* Minimax polynomials for 2^x on [-0.5, 0.5], highest power first. Degree 5 reaches float precision and is the one in
 * use; the others show what it costs (tools/measure/kernel_error.py). */
#define GS_EXP2_3 0.0550089329f, 0.242210969f, 0.693282902f, 1.0f
#define GS_EXP2_4 0.00958538242f, 0.0559066273f, 0.24024038f, 0.693124175f, 1.0f
#define GS_EXP2_5 0.0013276472f, 0.009675541f, 0.05550713f, 0.2402212f, 0.69314694f, 1.0f
#define GS_EXP2_6 0.000152723049f, 0.00134104793f, 0.00961877499f, 0.0555029362f, 0.240226448f, 0.693147242f, 1.0f

/* Adam: decay rates of its authors (Kingma and Ba 2015), and an eps far below the moments of splats, as in 3DGS. */
#define GS_ADAM_BETA1 0.9
#define GS_ADAM_BETA2 0.999
#define GS_ADAM_EPS 1e-15f

/* Philox 4x32 (Salmon et al. 2011, table 2): its multipliers, and the Weyl sequence of its key, which are the golden
 * ratio and sqrt(3) - 1 times 2^32. Ten rounds are its authors' choice; seven already pass all tests of theirs. */
#define GS_PHILOX_M0 0xD2511F53u
#define GS_PHILOX_M1 0xCD9E8D57u
#define GS_PHILOX_W0 0x9E3779B9u
#define GS_PHILOX_W1 0xBB67AE85u
#define GS_PHILOX_ROUNDS 10
/* Series of normal numbers by Box and Muller, highest power first, far below float precision: of 2 atanh(s) / s - 2 over
 * s^2 in s^2 with |s| < 0.172; of sin(pi / 2 f) / f and cos(pi / 2 f) in f^2 with |f| <= 1 / 2. */
#define GS_LN2 0.693147181f
#define GS_ATANH 2.0f / 9.0f, 2.0f / 7.0f, 2.0f / 5.0f, 2.0f / 3.0f
#define GS_SIN 1.60441185e-4f, -4.68175414e-3f, 7.96926262e-2f, -6.45964098e-1f, 1.57079633f
#define GS_COS 9.19260275e-4f, -2.08634808e-2f, 2.53669508e-1f, -1.23370055f, 1.0f

#endif

#version 300 es
// Contribution of a splat to a pixel, premultiplied by alpha and blended from back to front.
precision highp float;
in vec2 place;
flat in vec4 shade;
out vec4 pixel;

void main() {
    float alpha = shade.a * exp(-0.5 * dot(place, place));
    if (alpha < GS_ALPHA_MIN)
        discard;
    alpha = min(alpha, GS_ALPHA_MAX);
    pixel = vec4(shade.rgb * alpha, alpha);
}

#version 300 es
// How much of a splat lies before a pixel; blended from back to front, multiplied by its alpha.
precision highp float;
in vec2 place;
flat in vec4 shade;
out vec4 pixel;

void main() {
    float alpha = shade.a * exp(-0.5 * dot(place, place));
    if (alpha < 1.0 / 255.0)
        discard;
    alpha = min(alpha, 0.99);
    pixel = vec4(shade.rgb * alpha, alpha);
}

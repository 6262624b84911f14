// What the pixels of a picture see, four numbers at a time.

uniform vec2 size;  // pixels
uniform int part;
out vec4 pixel;

void main() {
    Seen seen;
    pixel = vec4(0.0);
    if (!look(2.0 * gl_FragCoord.xy / size - 1.0, seen)) return;
    if (part == 0) pixel = vec4(seen.position, seen.passed);
    if (part == 1) pixel = vec4(seen.facing, float(seen.facet));
    if (part == 2) pixel = vec4(seen.from_body, float(seen.site));
#ifdef LOBE
    if (part == 3) pixel = vec4(seen.to_camera, 0.0);
#endif
}

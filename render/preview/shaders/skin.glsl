// A skin that is not flat: its height over the pad, from textures (render.preview.skin_texels).

uniform sampler2D skin;  // normal into the pad and height over the pad, its border included
uniform vec2 half_pad;   // half width and length of the pad

vec4 skin_at(vec2 place) {
    vec2 steps = vec2(textureSize(skin, 0));
    vec2 along = clamp(0.5 * place / half_pad + 0.5, 0.0, 1.0);
    return texture(skin, (along * (steps - 1.0) + 0.5) / steps);
}

// The shading function: direct irradiance at a point of the pad from a list of secondary lights,
// once straight and once by way of the lower face, per channel.

uniform sampler2D lights;     // (light, list): x, y, z in flat pad coordinates (mm), edge (+ 4: beam)
uniform sampler2D emissions;  // (light * EMISSION_TEXELS + texel, list * CHANNELS + channel)
uniform int light_count;
uniform float base;       // y of the pad's lower end
uniform float near_base;  // lights below this y are seen in the base as well

#if CHANNELS == 3
#define Spectrum vec3
#else
#define Spectrum float
#endif

// A local direction in the frame of an edge: along it, into the pad, towards the coating.
vec3 to_edge(vec3 direction, float edge) {
    if (edge == 1.0) return vec3(direction.x, -direction.y, direction.z);
    return vec3(direction.y, edge == 0.0 ? direction.x : -direction.x, direction.z);
}

#ifdef BEAM

uniform float inverse_width;      // 1 / (2 sigma_v), rad^-1
uniform float optical_thickness;  // of the diffuser, 0 without one

// A fiber end behind the pad's smooth edge: Gaussian about its beam in air, refracted into the
// pad, dimmed by the diffuser. The emission is the beam and the intensity in air along it.
float beam_intensity(vec4 emission, vec3 d) {
    vec2 side = refractive_index * d.xz;
    float squared = 1.0 - dot(side, side);
    if (d.y <= 0.0 || squared <= 0.0) return 0.0;
    vec3 air = vec3(side.x, sqrt(squared), side.y);
    float cosine = dot(air, emission.xyz);
    float theta = atan(length(cross(air, emission.xyz)), cosine) * inverse_width;
    float solid_angle = refractive_index * refractive_index * d.y / air.y;
    float passed = (1.0 - reflectance(d.y)) * exp(-optical_thickness / d.y);
    return emission.w * exp(-theta * theta) * max(cosine, 0.0) * passed * solid_angle;
}

#endif

#ifdef GLOW

// The glow of a diffuser: a polynomial radiance (render.slab_basis) times the cosine.
float glow_intensity(vec4 low, vec4 high, float last, vec3 d) {
    float radiance = dot(low, vec4(1.0, d.x, d.z, d.x * d.x))
        + dot(high, vec4(d.x * d.z, d.z * d.z, d.y, d.y * d.x)) + last * d.y * d.z;
    return radiance * max(d.y, 0.0);
}

#endif

// What light `i` of emission row `row` sends into two directions, each with its weight.
float sent(int i, int row, bool beam, vec3 d, float by_d, vec3 m, float by_m) {
    ivec2 texel = ivec2(i * EMISSION_TEXELS, row);
    vec4 low = texelFetch(emissions, texel, 0);
#ifdef BEAM
#ifdef GLOW
    if (beam)
#endif
    return by_d * beam_intensity(low, d) + by_m * beam_intensity(low, m);
#endif
#ifdef GLOW
    vec4 high = texelFetchOffset(emissions, texel, 0, ivec2(1, 0));
    float last = texelFetchOffset(emissions, texel, 0, ivec2(2, 0)).x;
    return by_d * glow_intensity(low, high, last, d) + by_m * glow_intensity(low, high, last, m);
#endif
}

float received(Path path, vec3 normal) {
    return path.spread * max(dot(path.arrive, normal), 0.0);
}

// Direct irradiance (1/mm^2 per unit power) at a flat pad position with a local unit normal.
// `first` is the row of `lights`, `list` the row (or group of rows) of `emissions`. Lights near the
// base, the clear lower end of the pad, also shine by their image in it.
Spectrum irradiance(vec3 position, vec3 normal, int first, int list) {
    Spectrum sum = Spectrum(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec4 light = texelFetch(lights, ivec2(i, first), 0);
        bool beam = light.w >= 4.0;
        float edge = beam ? light.w - 4.0 : light.w;
        int images = light.y < near_base ? 2 : 1;
        for (int image = 0; image < images; ++image) {
            if (image == 1) light.y = 2.0 * base - light.y;
            vec2 turn = half_turn(light.xyz, position);
            Path direct = direct_path(light.xyz, position, turn);
            Path mirrored = mirrored_path(light.xyz, position, turn);
            float by_d = received(direct, normal), by_m = received(mirrored, normal);
            if (image == 1) {
                by_d *= reflectance(abs(direct.depart.y));
                by_m *= reflectance(abs(mirrored.depart.y));
                direct.depart.y = -direct.depart.y;
                mirrored.depart.y = -mirrored.depart.y;
            }
            vec3 d = to_edge(direct.depart, edge), m = to_edge(mirrored.depart, edge);
#if CHANNELS == 3
            for (int c = 0; c < 3; ++c) sum[c] += sent(i, 3 * list + c, beam, d, by_d, m, by_m);
#else
            sum += sent(i, list, beam, d, by_d, m, by_m);
#endif
        }
    }
    return sum;
}

// The shading function: direct irradiance at a point of the pad from a list of secondary lights,
// straight and by way of the lower face, per channel.

// (light, list): x, y, z in flat pad coordinates (mm); mark: the edge's number, + 4 for a beam,
// + 8 (i + 1) for the image of light i in the pad's base, -1 behind the last light of a list.
uniform sampler2D lights;
uniform sampler2D emissions;  // (light * EMISSION_TEXELS + texel, list * CHANNELS + channel)
uniform int light_count;

#if CHANNELS == 3
#define Spectrum vec3
#else
#define Spectrum float
#endif

// A local direction in the frame of an edge: along it, into the pad, towards the coating.
vec3 to_edge(vec3 direction, int edge) {
    if (edge == 1) return vec3(direction.x, -direction.y, direction.z);
    return vec3(direction.y, edge == 0 ? direction.x : -direction.x, direction.z);
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

// The glow of a diffuser: a polynomial radiance (render.preview.diffuser.basis) times the cosine.
float glow_intensity(vec4 low, vec4 high, float last, vec3 d) {
    float radiance = dot(low, vec4(1.0, d.x, d.z, d.x * d.x))
        + dot(high, vec4(d.x * d.z, d.z * d.z, d.y, d.y * d.x)) + last * d.y * d.z;
    return radiance * max(d.y, 0.0);
}

#endif

// What light `i` of emission row `row` sends into two directions.
vec2 intensities(int i, int row, bool beam, vec3 d, vec3 m) {
    ivec2 texel = ivec2(i * EMISSION_TEXELS, row);
    vec4 low = texelFetch(emissions, texel, 0);
#ifdef BEAM
#ifdef GLOW
    if (beam)
#endif
    return vec2(beam_intensity(low, d), beam_intensity(low, m));
#endif
#ifdef GLOW
    vec4 high = texelFetchOffset(emissions, texel, 0, ivec2(1, 0));
    float last = texelFetchOffset(emissions, texel, 0, ivec2(2, 0)).x;
    return vec2(glow_intensity(low, high, last, d), glow_intensity(low, high, last, m));
#endif
}

struct Light {
    Spectrum here;  // direct irradiance at the point
    Spectrum foot;  // and on the coating at the foot of its facet, unless the pyramid is before it
};

#ifdef FACES

uniform vec4 facet_planes[FACES];  // outward normal in the site's frame, distance from its center
// The coating's point from the nearest pyramid's center; beyond shadow_radius nothing is tested.
vec3 from_pyramid;
float shadow_radius = 0.0;

// 1 where the way from a point of the coating towards a light passes the pyramid, 0 behind it. Its
// frame is taken for the point's own, as shadows are short against the radius of the bend.
float past_pyramid(vec3 arrive) {
    float enter = 0.0, leave = 1e9;
    for (int i = 0; i < FACES; ++i) {
        float speed = dot(facet_planes[i].xyz, arrive);
        float room = facet_planes[i].w - dot(facet_planes[i].xyz, from_pyramid);
        if (speed < 0.0) enter = max(enter, room / speed);
        else leave = min(leave, room / max(speed, 1e-9));
    }
    return enter < leave ? 0.0 : 1.0;
}

#endif

// Irradiance in 1/mm^2 per unit power at a flat pad position with a local unit normal. `first` is
// the row of `lights`, `list` the row (or group of rows) of `emissions`.
Light irradiance(vec3 position, vec3 normal, int first, int list) {
    Light sum = Light(Spectrum(0.0), Spectrum(0.0));
    for (int i = 0; i < light_count; ++i) {
        vec4 light = texelFetch(lights, ivec2(i, first), 0);
        if (light.w < 0.0) break;
        int mark = int(light.w), sender = mark < 8 ? i : mark / 8 - 1;
        bool beam = (mark & 4) != 0;
        vec2 turn = half_turn(light.xyz, position);
        Path direct = direct_path(light.xyz, position, turn);
        Path mirrored = mirrored_path(light.xyz, position, turn);
        vec2 spread = vec2(direct.spread, mirrored.spread);
        if (mark >= 8) {
            spread *= vec2(reflectance(abs(direct.depart.y)), reflectance(abs(mirrored.depart.y)));
            direct.depart.y = -direct.depart.y;
            mirrored.depart.y = -mirrored.depart.y;
        }
        vec3 d = to_edge(direct.depart, mark & 3), m = to_edge(mirrored.depart, mark & 3);
        vec2 cosine = vec2(dot(direct.arrive, normal), dot(mirrored.arrive, normal));
        vec2 here = spread * max(cosine, 0.0);
#ifdef FACES
        if (length(from_pyramid.xy) < shadow_radius)
            here *= vec2(past_pyramid(direct.arrive), past_pyramid(mirrored.arrive));
#endif
        vec2 foot = step(0.0, cosine) * spread
            * max(-vec2(direct.arrive.z, mirrored.arrive.z), 0.0);
#if CHANNELS == 3
        for (int c = 0; c < 3; ++c) {
            vec2 sent = intensities(sender, 3 * list + c, beam, d, m);
            sum.here[c] += dot(here, sent);
            sum.foot[c] += dot(foot, sent);
        }
#else
        vec2 sent = intensities(sender, list, beam, d, m);
        sum.here += dot(here, sent);
        sum.foot += dot(foot, sent);
#endif
    }
    return sum;
}

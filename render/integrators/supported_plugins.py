"""The plugins of Mitsuba that ``bdpt`` and ``pssmlt`` render, and the parameters that each has.

A positive list: what is not on it is refused by name (``render.integrators.supported_content``).
An entry is kind -> plugin -> (class, names), where names are all that an object of the class shows
by ``traverse`` or in its description. ``tests/validation/test_gallery.py`` renders each plugin, and
fails on one of the installed Mitsuba that is neither here nor refused there.
"""

from __future__ import annotations

_ROUGHNESS = "alpha alpha_u alpha_v distribution sample_visible"
_SPECULAR = "eta specular_reflectance specular_transmittance"
_PRINCIPLED = (
    "anisotropic base_color diffuse_reflectance_sampling_rate eta flatness roughness sheen "
    "sheen_tint spec_tint spec_trans"
)
_LENS = (
    "far_clip film medium near_clip resolution sampler shutter_open shutter_open_time to_world "
    "x_fov"
)
_SHAPE = "bsdf emitter exterior_medium interior_medium sensor silhouette_sampling_weight"
_QUADRIC = f"{_SHAPE} center frame length radius surface_area to_world"
_MESH = (
    f"{_SHAPE} bbox disable_vertex_normals face_count face_normals faces name surface_area "
    "vertex_count vertex_normals vertex_positions vertex_texcoords vertices"
)
_CURVE = f"{_SHAPE} control_point_count control_points segment_count segment_indices"
_BITMAP = "data mean name raw resolution to_uv transform"

PLUGINS: dict[str, dict[str, tuple[str, str]]] = {
    "sensor": {
        "perspective": (
            "PerspectiveCamera", f"{_LENS} principal_point_offset_x principal_point_offset_y"
        ),
        "thinlens": ("ThinLensCamera", f"{_LENS} aperture_radius focus_distance"),
    },
    "film": {
        "hdrfilm": (
            "HDRFilm",
            "component_format crop_offset crop_size file_format filter pixel_format sample_border "
            "size",
        ),
    },
    "rfilter": {
        "box": ("BoxFilter", ""),
        "gaussian": ("GaussianFilter", "radius stddev"),
        "tent": ("TentFilter", "radius"),
    },
    # Only the number of samples is taken from these: it is all that a picture's mean depends on.
    "sampler": {
        "independent": (
            "IndependentSampler", "base_seed sample_count samples_per_wavefront wavefront_size"
        ),
        "stratified": ("StratifiedSampler", "jitter sample_count"),
        "multijitter": ("MultijitterSampler", "jitter sample_count"),
        "orthogonal": ("OrthogonalSampler", "jitter sample_count"),
        "ldsampler": ("LowDiscrepancySampler", "sample_count"),
    },
    "emitter": {
        "area": ("AreaLight", "radiance sampling_weight surface_area"),
        "point": ("PointLight", "intensity medium position sampling_weight"),
        "spot": (
            "SpotLight",
            "beam_width cutoff_angle intensity medium sampling_weight texture to_world",
        ),
        "directional": ("DirectionalEmitter", "bsphere irradiance sampling_weight to_world"),
        "constant": ("ConstantBackgroundEmitter", "bsphere radiance sampling_weight"),
        "envmap": ("EnvironmentMapEmitter", "bsphere data res sampling_weight scale to_world"),
        "fiber": ("FiberEmitter", ""),
        "measured_light": ("MeasuredEmitter", ""),
    },
    "shape": {
        "rectangle": ("Rectangle", _QUADRIC),
        "disk": ("Disk", _QUADRIC),
        "sphere": ("Sphere", _QUADRIC),
        "cylinder": ("Cylinder", _QUADRIC),
        "cube": ("Cube", _MESH),
        "obj": ("OBJMesh", _MESH),
        "ply": ("PLYMesh", _MESH),
        "serialized": ("SerializedMesh", _MESH),
        "mi.Mesh": ("Mesh", _MESH),
        "bsplinecurve": ("BSplineCurve", _CURVE),
        "linearcurve": ("LinearCurve", _CURVE),
        "instance": ("Instance", f"{_SHAPE} shapegroup to_world"),
        "shapegroup": ("ShapeGroupPlugin", "name prim_count"),
    },
    "bsdf": {
        "diffuse": ("SmoothDiffuse", "reflectance"),
        "conductor": ("SmoothConductor", "eta k specular_reflectance"),
        "roughconductor": ("RoughConductor", f"{_ROUGHNESS} eta k specular_reflectance"),
        "dielectric": ("SmoothDielectric", _SPECULAR),
        "roughdielectric": ("RoughDielectric", f"{_ROUGHNESS} {_SPECULAR}"),
        "thindielectric": ("ThinDielectric", _SPECULAR),
        "plastic": (
            "SmoothPlastic",
            "diffuse_reflectance eta fdr_ext fdr_int nonlinear specular_reflectance "
            "specular_sampling_weight",
        ),
        "roughplastic": (
            "RoughPlastic",
            f"{_ROUGHNESS} diffuse_reflectance eta nonlinear specular_reflectance "
            "specular_sampling_weight",
        ),
        "pplastic": (
            "PolarizedPlastic", f"{_ROUGHNESS} diffuse_reflectance eta specular_reflectance"
        ),
        "principled": (
            "Principled",
            f"{_PRINCIPLED} clearcoat clearcoat_gloss clearcoat_sampling_rate "
            "main_specular_sampling_rate metallic specular",
        ),
        "principledthin": (
            "PrincipledThin",
            f"{_PRINCIPLED} diff_trans diffuse_transmittance_sampling_rate "
            "specular_reflectance_sampling_rate specular_transmittance_sampling_rate",
        ),
        "twosided": ("TwoSidedBRDF", "brdf brdf_0 brdf_1"),
        "mask": ("MaskBSDF", "nested_bsdf opacity"),
        "blendbsdf": ("BlendBSDF", "bsdf_0 bsdf_1 nested_bsdf weight"),
        "null": ("Null", ""),
    },
    "medium": {"homogeneous": ("HomogeneousMedium", "albedo phase_function scale sigma_t")},
    "phase": {
        "isotropic": ("IsotropicPhaseFunction", ""),
        "hg": ("HGPhaseFunction", "g"),
        "rayleigh": ("RayleighPhaseFunction", ""),
        "tabphase": ("TabulatedPhaseFunction", "distr values"),
        "blendphase": ("BlendPhaseFunction", "nested_phase phase_0 phase_1 weight"),
    },
    "texture": {
        "bitmap": ("BitmapTextureImpl", _BITMAP),
        "checkerboard": ("Checkerboard", "color0 color1 to_uv transform"),
        "uniform": ("UniformSpectrum", "value"),
        "srgb": ("SRGBReflectanceSpectrum", "value"),
        "rawconstant": ("RawConstantTexture", "value"),
        "volume": ("VolumeAdapter", "volume"),
    },
    "volume": {
        "constvolume": ("ConstVolume", "to_local value"),
        "gridvolume": ("GridVolume", "bbox channels data dimensions max to_local"),
    },
}  # fmt: skip

REFUSED = {
    "NormalMap": ("normalmap", "bend the mesh instead, or use path"),
    "BumpMap": ("bumpmap", "bend the mesh instead, or use path"),
    "LinearPolarizer": ("polarizer", "use path or volpath"),
    "CircularPolarizer": ("circular", "use path or volpath"),
    "LinearRetarder": ("retarder", "use path or volpath"),
    "MeshAttribute": ("mesh_attribute", "use a texture over uv, or path"),
    "SDFGrid": ("sdfgrid", "make a mesh of it, or use path"),
    "HeterogeneousMedium": ("heterogeneous", "use volpath"),
    "SGGXPhaseFunction": ("sggx", "use volpath"),
}
"""Plugin and next step of some classes that are not on the list, to be named in a message."""

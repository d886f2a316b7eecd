// The base layer: emission + albedo / pi x irradiance, with depth, object id, texture level and
// triangle. Twin of foveal::display; names as there.

struct View {
    clip_from_world: mat4x4f,
    eye: vec4f,
    forward: vec4f,
    right: vec4f,
    up: vec4f,
    // Picture width and height, lightmap width and height.
    sizes: vec4u,
    // Bit 0: some backs are lit; bit 1: the environment has a map.
    flags: vec4u,
    // Radiance, and the rotation about up in turns.
    environment_radiance: vec4f,
    // The environment's axes (y up) in the world.
    environment_rows: array<vec4f, 3>,
    // Angle of one pixel at the picture's centre.
    pixel: vec4f,
}

struct Triangle {
    triangle: u32,
    object: u32,
    material: u32,
    light_kind: u32,
    uvs: array<vec2f, 3>,
    light: array<vec2f, 3>,
    // Texture coordinates per scene unit.
    uv_density: f32,
    padding: u32,
}

struct Material {
    albedo: vec3f,
    albedo_map: u32,
    emission: vec3f,
    flags: u32,
    opacity: f32,
    // What a coat lets in and out, and what it sends back to the base: 1 and 0 without coat.
    coat_passes: f32,
    coat_returns: f32,
    padding: u32,
    scale_offset: array<vec4f, 3>,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> triangles: array<Triangle>;
@group(0) @binding(2) var<storage, read> materials: array<Material>;
@group(0) @binding(3) var<storage, read> front_light: array<f32>;
@group(0) @binding(4) var<storage, read> back_light: array<f32>;
@group(0) @binding(5) var environment_map: texture_2d<f32>;

@group(1) @binding(0) var albedo_map: texture_2d<f32>;
@group(1) @binding(1) var albedo_sampler: sampler;
@group(1) @binding(2) var emission_map: texture_2d<f32>;
@group(1) @binding(3) var emission_sampler: sampler;
@group(1) @binding(4) var opacity_map: texture_2d<f32>;
@group(1) @binding(5) var opacity_sampler: sampler;

const LIGHT_TEXELS: u32 = 0u;
const TWO_SIDED: u32 = 1u;
const OPACITY_IS_ALPHA: u32 = 2u;
const HAS_ALBEDO_MAP: u32 = 4u;
const HAS_EMISSION_MAP: u32 = 8u;
const HAS_OPACITY_MAP: u32 = 16u;
// Whether pixels may be left out. Where none can be, depth is tested before they are computed.
override MASKED: bool = true;
const NO_TEXTURE: u32 = 0xffffffffu;
const INVERSE_PI: f32 = 0.31830988618;

struct Corner {
    @builtin(position) position: vec4f,
    // Barycentric weights of the second and third corner, and depth along the view axis.
    @location(0) barycentric_depth: vec3f,
    @location(1) @interpolate(flat) record: u32,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, @location(0) position: vec3f) -> Corner {
    let corner = index % 3u;
    var out: Corner;
    out.position = view.clip_from_world * vec4f(position, 1.0);
    out.barycentric_depth = vec3f(
        select(0.0, 1.0, corner == 1u),
        select(0.0, 1.0, corner == 2u),
        dot(position - view.eye.xyz, view.forward.xyz),
    );
    out.record = index / 3u;
    return out;
}

struct Pixel {
    @location(0) color: vec4f,
    @location(1) depth: f32,
    @location(2) object: u32,
    @location(3) texture: u32,
    @location(4) triangle: u32,
}

fn element(index: u32, back: bool) -> vec3f {
    let i = 3u * index;
    if back {
        return vec3f(back_light[i], back_light[i + 1u], back_light[i + 2u]);
    }
    return vec3f(front_light[i], front_light[i + 1u], front_light[i + 2u]);
}

// Through a picture position, with length 1 along the view axis.
fn view_direction(position: vec2f) -> vec3f {
    let s = 2.0 * position / vec2f(view.sizes.xy) - 1.0;
    return view.forward.xyz + view.right.xyz * s.x - view.up.xyz * s.y;
}

// Twin of illumination::stored::Illumination::lookup.
fn irradiance(t: u32, b1: f32, b2: f32, back: bool) -> vec3f {
    if back && (view.flags.x & 1u) == 0u {
        return vec3f(0.0);
    }
    let b0 = 1.0 - b1 - b2;
    let l0 = triangles[t].light[0];
    let l1 = triangles[t].light[1];
    let l2 = triangles[t].light[2];
    if triangles[t].light_kind != LIGHT_TEXELS {
        return element(bitcast<u32>(l0.x), back) * max(b0, 0.0)
            + element(bitcast<u32>(l1.x), back) * max(b1, 0.0)
            + element(bitcast<u32>(l2.x), back) * max(b2, 0.0);
    }
    let last = vec2f(view.sizes.zw) - 1.0;
    let p = clamp(l0 * b0 + l1 * b1 + l2 * b2 - 0.5, vec2f(0.0), last);
    let low = vec2u(p);
    let high = min(low + 1u, view.sizes.zw - 1u);
    let f = p - vec2f(low);
    let width = view.sizes.z;
    let above = mix(element(low.y * width + low.x, back), element(low.y * width + high.x, back), f.x);
    let below = mix(element(high.y * width + low.x, back), element(high.y * width + high.x, back), f.x);
    return mix(above, below, f.y);
}

// Coordinates in a texture: scaled, and with the origin at the upper left as its rows have it.
fn texture_coordinates(uv: vec2f, scale_offset: vec4f) -> vec2f {
    let p = uv * scale_offset.xy + scale_offset.zw;
    return vec2f(p.x, 1.0 - p.y);
}

// Twin of transport::interaction::mip_level.
fn mip_level(uv_density: f32, footprint: f32, size: vec2u) -> f32 {
    let texels = footprint * uv_density * f32(max(size.x, size.y));
    return select(0.0, min(log2(texels), 31.0), texels > 1.0);
}

@fragment
fn fragment(in: Corner, @builtin(front_facing) front: bool) -> Pixel {
    let t = in.record;
    let b1 = in.barycentric_depth.x;
    let b2 = in.barycentric_depth.y;
    let b0 = 1.0 - b1 - b2;
    let uv = triangles[t].uvs[0] * b0 + triangles[t].uvs[1] * b1 + triangles[t].uvs[2] * b2;
    // Distance x angle of a pixel.
    let footprint = in.barycentric_depth.z * view.pixel.x * length(view_direction(in.position.xy));
    let m = triangles[t].material;
    let flags = materials[m].flags;

    if MASKED && (flags & HAS_OPACITY_MAP) != 0u {
        let p = texture_coordinates(uv, materials[m].scale_offset[2]);
        let texel = textureSampleLevel(opacity_map, opacity_sampler, p, 0.0);
        let grey = select((texel.r + texel.g + texel.b) / 3.0, texel.a, (flags & OPACITY_IS_ALPHA) != 0u);
        if materials[m].opacity * grey < 0.5 {
            discard;
        }
    } else if MASKED && materials[m].opacity < 0.5 {
        discard;
    }

    var out: Pixel;
    out.depth = in.barycentric_depth.z;
    out.object = triangles[t].object;
    out.triangle = triangles[t].triangle;
    out.texture = NO_TEXTURE;

    var albedo = materials[m].albedo;
    if (flags & HAS_ALBEDO_MAP) != 0u {
        let scale_offset = materials[m].scale_offset[0];
        let level = mip_level(triangles[t].uv_density, footprint, textureDimensions(albedo_map, 0));
        let p = texture_coordinates(uv, scale_offset);
        albedo *= textureSampleLevel(albedo_map, albedo_sampler, p, 0.0).rgb;
        out.texture = (materials[m].albedo_map << 8u) | u32(min(level, 31.0) * 8.0);
    }
    albedo = clamp(albedo, vec3f(0.0), vec3f(1.0));
    albedo *= materials[m].coat_passes / (1.0 - albedo * materials[m].coat_returns);
    var radiance = vec3f(0.0);
    if front || (flags & TWO_SIDED) != 0u {
        radiance = albedo * INVERSE_PI * irradiance(t, b1, b2, !front);
    }
    if front {
        var emission = materials[m].emission;
        if (flags & HAS_EMISSION_MAP) != 0u {
            let scale_offset = materials[m].scale_offset[1];
            let p = texture_coordinates(uv, scale_offset);
            emission *= textureSampleLevel(emission_map, emission_sampler, p, 0.0).rgb;
        }
        radiance += emission;
    }
    // The largest finite half.
    out.color = vec4f(min(radiance, vec3f(65504.0)), 1.0);
    return out;
}

// The surrounding, where no triangle is.

@vertex
fn background_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    // One triangle over the whole picture, at depth 0: infinitely far.
    return vec4f(select(-1.0, 3.0, index == 1u), select(-1.0, 3.0, index == 2u), 0.0, 1.0);
}

// Twin of scene::environment::Environment::radiance.
fn environment(direction: vec3f) -> vec3f {
    if (view.flags.x & 2u) == 0u {
        return view.environment_radiance.rgb;
    }
    let d = vec3f(
        dot(view.environment_rows[0].xyz, direction),
        dot(view.environment_rows[1].xyz, direction),
        dot(view.environment_rows[2].xyz, direction),
    );
    let size = vec2i(textureDimensions(environment_map, 0));
    let u = atan2(d.x, -d.z) * 0.15915494309 + view.environment_radiance.w;
    let v = clamp(0.5 - atan2(d.y, length(d.xz)) * INVERSE_PI, 0.0, 1.0);
    let p = vec2f((u - floor(u)) * f32(size.x), v * f32(size.y)) - 0.5;
    let low = vec2i(floor(p));
    let f = p - floor(p);
    let x0 = (low.x + size.x) % size.x;
    let x1 = (low.x + 1 + size.x) % size.x;
    let y0 = clamp(low.y, 0, size.y - 1);
    let y1 = clamp(low.y + 1, 0, size.y - 1);
    let above = mix(textureLoad(environment_map, vec2i(x0, y0), 0), textureLoad(environment_map, vec2i(x1, y0), 0), f.x);
    let below = mix(textureLoad(environment_map, vec2i(x0, y1), 0), textureLoad(environment_map, vec2i(x1, y1), 0), f.x);
    return mix(above, below, f.y).rgb * view.environment_radiance.rgb;
}

@fragment
fn background_fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let direction = normalize(view_direction(position.xy));
    return vec4f(min(environment(direction), vec3f(65504.0)), 1.0);
}

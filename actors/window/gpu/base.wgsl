// The base layer: emission + albedo / pi x irradiance, with depth, object id and texture level. The CPU
// pass is foveal::display; names as there.
//
// First the rasteriser finds out which triangle each pixel shows and nothing else; then every pixel is shaded once, by
// the run of triangles (of one set of textures) that it shows.

struct View {
    clip_from_world: mat4x4f,
    eye: vec4f,
    forward: vec4f,
    right: vec4f,
    up: vec4f,
    // Picture width and height, lightmap width and height.
    sizes: vec4u,
    // Bit 0: some backs are lit; bit 1: the environment has a map. Then the number of elements.
    flags: vec4u,
    // Radiance, and the rotation about up in turns.
    environment_radiance: vec4f,
    // The environment's axes (y up) in the world.
    environment_rows: array<vec4f, 3>,
    // Angle of one pixel at the picture's centre; unit of the light.
    pixel: vec4f,
}

@group(0) @binding(0) var<uniform> view: View;
// Records of geometry.rs, in texels: software fetches those faster than words of a buffer.
@group(0) @binding(1) var triangles: texture_2d<u32>;
@group(0) @binding(2) var materials: texture_2d<u32>;
// Irradiance of the elements' fronts, then of their backs, divided by view.pixel.y.
@group(0) @binding(3) var light: texture_2d<f32>;
@group(0) @binding(4) var environment_map: texture_2d<f32>;

@group(1) @binding(0) var albedo_map: texture_2d<f32>;
@group(1) @binding(1) var albedo_sampler: sampler;
@group(1) @binding(2) var emission_map: texture_2d<f32>;
@group(1) @binding(3) var emission_sampler: sampler;
@group(1) @binding(4) var opacity_map: texture_2d<f32>;
@group(1) @binding(5) var opacity_sampler: sampler;

@group(2) @binding(0) var visible_triangles: texture_2d<u32>;

const TRIANGLE_TEXELS: u32 = 7u;
const MATERIAL_TEXELS: u32 = 10u;
const ROW_SHIFT: u32 = 12u;
const LIGHT_TEXELS: u32 = 0u;
const TWO_SIDED: u32 = 1u;
const OPACITY_IS_ALPHA: u32 = 2u;
const HAS_ALBEDO_MAP: u32 = 4u;
const HAS_EMISSION_MAP: u32 = 8u;
const HAS_OPACITY_MAP: u32 = 16u;
const SHADELESS: u32 = 32u;
const CULLED: u32 = 64u;
// Whether any material has a texture.
override TEXTURED: bool = true;
const NO_TEXTURE: u32 = 0xffffffffu;
const NO_TRIANGLE: u32 = 0xffffffffu;
const INVERSE_PI: f32 = 0.31830988618;

struct Corner {
    @builtin(position) position: vec4f,
    @location(0) @interpolate(flat) record: u32,
    // Barycentric weights of the second and third corner.
    @location(1) barycentric: vec2f,
}

@vertex
fn vertex(@builtin(vertex_index) index: u32, @location(0) position: vec3f) -> Corner {
    let corner = index % 3u;
    var out: Corner;
    out.position = view.clip_from_world * vec4f(position, 1.0);
    out.barycentric = vec2f(select(0.0, 1.0, corner == 1u), select(0.0, 1.0, corner == 2u));
    out.record = index / 3u;
    return out;
}

@fragment
fn visible(@location(0) @interpolate(flat) record: u32) -> @location(0) u32 {
    return record;
}

// Texel `i` of a long row.
fn place(i: u32) -> vec2u {
    return vec2u(i & ((1u << ROW_SHIFT) - 1u), i >> ROW_SHIFT);
}

fn triangle(t: u32, texel: u32) -> vec4u {
    return textureLoad(triangles, place(t * TRIANGLE_TEXELS + texel), 0);
}

fn material(m: u32, texel: u32) -> vec4u {
    return textureLoad(materials, place(m * MATERIAL_TEXELS + texel), 0);
}

fn scale_offset(m: u32, map: u32) -> vec4f {
    return bitcast<vec4f>(material(m, 3u + map));
}

// Texels of level 0 per texture coordinate, and the finest level that is held.
fn texels_of(m: u32, map: u32) -> vec2f {
    return bitcast<vec2f>(material(m, 6u + map).xy);
}

fn uv_at(t: u32, b1: f32, b2: f32) -> vec2f {
    let first = bitcast<vec4f>(triangle(t, 5u));
    let third = bitcast<vec2f>(triangle(t, 6u).xy);
    return first.xy * (1.0 - b1 - b2) + first.zw * b1 + third * b2;
}

// Whether the eye is behind a triangle.
fn is_back(t: u32) -> bool {
    let a = bitcast<vec3f>(triangle(t, 0u).xyz);
    let b = bitcast<vec3f>(triangle(t, 1u).xyz);
    let c = bitcast<vec3f>(triangle(t, 2u).xyz);
    return dot(cross(b - a, c - a), view.eye.xyz - a) < 0.0;
}

@fragment
fn visible_through_mask(in: Corner) -> @location(0) u32 {
    let m = triangle(in.record, 1u).w;
    let flags = material(m, 0u).w;
    var opacity = bitcast<f32>(material(m, 2u).z);
    if (flags & HAS_OPACITY_MAP) != 0u {
        let uv = uv_at(in.record, in.barycentric.x, in.barycentric.y);
        let p = texture_coordinates(uv, scale_offset(m, 2u));
        let texel = textureSampleLevel(opacity_map, opacity_sampler, p, 0.0);
        opacity *= select((texel.r + texel.g + texel.b) / 3.0, texel.a, (flags & OPACITY_IS_ALPHA) != 0u);
    }
    if opacity < 0.5 || ((flags & CULLED) != 0u && is_back(in.record)) {
        discard;
    }
    return in.record;
}

struct Pixel {
    @location(0) color: vec4f,
    @location(1) depth: f32,
    @location(2) object: u32,
    @location(3) texture: u32,
}

fn element(index: u32) -> vec3f {
    return textureLoad(light, place(index), 0).rgb;
}

// Through a picture position, with length 1 along the view axis.
fn view_direction(position: vec2f) -> vec3f {
    let s = 2.0 * position / vec2f(view.sizes.xy) - 1.0;
    return view.forward.xyz + view.right.xyz * s.x - view.up.xyz * s.y;
}

// The CPU pass is illumination::stored::Illumination::lookup.
fn irradiance(t: u32, kind: u32, b1: f32, b2: f32, back: bool) -> vec3f {
    if back && (view.flags.x & 1u) == 0u {
        return vec3f(0.0);
    }
    let b0 = 1.0 - b1 - b2;
    let l01 = triangle(t, 3u);
    let l2 = triangle(t, 4u).xy;
    // Texels of the lightmap around the point, or elements at the corners; either way a weighted sum.
    let last = vec2f(view.sizes.zw) - 1.0;
    let at = bitcast<vec2f>(l01.xy) * b0 + bitcast<vec2f>(l01.zw) * b1 + bitcast<vec2f>(l2) * b2 - 0.5;
    let p = clamp(at, vec2f(0.0), last);
    let low = vec2u(p);
    let high = min(low + 1u, view.sizes.zw - 1u);
    let f = p - vec2f(low);
    let width = view.sizes.z;
    var index = vec4u(low.y * width + low.x, low.y * width + high.x, high.y * width + low.x, high.y * width + high.x);
    var weight = vec4f((1.0 - f.x) * (1.0 - f.y), f.x * (1.0 - f.y), (1.0 - f.x) * f.y, f.x * f.y);
    if kind != LIGHT_TEXELS {
        index = vec4u(l01.x, l01.z, l2.x, l2.x);
        weight = vec4f(max(b0, 0.0), max(b1, 0.0), max(b2, 0.0), 0.0);
    }
    index += select(0u, view.flags.y, back);
    let sum = element(index.x) * weight.x + element(index.y) * weight.y + element(index.z) * weight.z
        + element(index.w) * weight.w;
    return sum * view.pixel.y;
}

// Coordinates in a texture: scaled, and with the origin at the upper left as its rows have it.
fn texture_coordinates(uv: vec2f, scale_offset: vec4f) -> vec2f {
    let p = uv * scale_offset.xy + scale_offset.zw;
    return vec2f(p.x, 1.0 - p.y);
}

// The CPU pass is transport::interaction::mip_level.
fn mip_level(uv_density: f32, footprint: f32, texels_per_uv: f32) -> f32 {
    let texels = footprint * uv_density * texels_per_uv;
    return select(0.0, min(log2(texels), 31.0), texels > 1.0);
}

struct Run {
    @builtin(position) position: vec4f,
    // Its triangles.
    @location(0) @interpolate(flat) first: u32,
    @location(1) @interpolate(flat) end: u32,
}

// One triangle over the whole picture.
fn whole_picture(index: u32) -> vec4f {
    return vec4f(select(-1.0, 3.0, index == 1u), select(-1.0, 3.0, index == 2u), 0.0, 1.0);
}

@vertex
fn run_vertex(@builtin(vertex_index) index: u32, @location(0) range: vec2u) -> Run {
    return Run(whole_picture(index), range.x, range.y);
}

@fragment
fn shade(in: Run) -> Pixel {
    let t = textureLoad(visible_triangles, vec2i(in.position.xy), 0).x;
    if t < in.first || t >= in.end {
        discard;
    }
    let a = triangle(t, 0u);
    let b = triangle(t, 1u);
    let c = triangle(t, 2u);
    // Where the pixel's ray meets the triangle's plane (Moeller and Trumbore 1997).
    let ray = view_direction(in.position.xy);
    let origin = bitcast<vec3f>(a.xyz);
    let e1 = bitcast<vec3f>(b.xyz) - origin;
    let e2 = bitcast<vec3f>(c.xyz) - origin;
    let s = view.eye.xyz - origin;
    let p = cross(ray, e2);
    let q = cross(s, e1);
    let determinant = dot(e1, p);
    let b1 = clamp(dot(s, p) / determinant, 0.0, 1.0);
    let b2 = clamp(dot(ray, q) / determinant, 0.0, 1.0 - b1);
    let depth = dot(e2, q) / determinant;
    let front = determinant > 0.0;

    let m = b.w;
    let reflection = material(m, 0u);
    let own_light = material(m, 1u);
    let flags = reflection.w;
    var out: Pixel;
    out.depth = depth;
    out.object = a.w;
    out.texture = NO_TEXTURE;

    var albedo = bitcast<vec3f>(reflection.xyz);
    var emission = bitcast<vec3f>(own_light.xyz);
    if TEXTURED {
        let uv = uv_at(t, b1, b2);
        let footprint = depth * view.pixel.x * length(ray);
        let uv_density = bitcast<f32>(triangle(t, 4u).z);
        if own_light.w != NO_TEXTURE {
            let level = mip_level(uv_density, footprint, texels_of(m, 3u).x);
            out.texture = (own_light.w << 8u) | u32(level * 8.0);
        }
        if (flags & HAS_ALBEDO_MAP) != 0u {
            let texels = texels_of(m, 0u);
            let level = mip_level(uv_density, footprint, texels.x) - texels.y;
            let at = texture_coordinates(uv, scale_offset(m, 0u));
            albedo *= textureSampleLevel(albedo_map, albedo_sampler, at, level).rgb;
            albedo = clamp(albedo, vec3f(0.0), vec3f(1.0));
            let coat = bitcast<vec2f>(material(m, 2u).xy);
            albedo *= coat.x / (1.0 - albedo * coat.y);
        }
        if (flags & HAS_EMISSION_MAP) != 0u {
            let texels = texels_of(m, 1u);
            let level = mip_level(uv_density, footprint, texels.x) - texels.y;
            let at = texture_coordinates(uv, scale_offset(m, 1u));
            emission *= textureSampleLevel(emission_map, emission_sampler, at, level).rgb;
        }
    }
    var radiance = vec3f(0.0);
    if front || (flags & TWO_SIDED) != 0u {
        radiance = albedo * INVERSE_PI * irradiance(t, c.w, b1, b2, !front);
    }
    if front || (flags & SHADELESS) != 0u {
        radiance += emission;
    }
    // The largest finite half.
    out.color = vec4f(min(radiance, vec3f(65504.0)), 1.0);
    return out;
}

// The environment, where no triangle is.

// The CPU pass is scene::environment::Environment::radiance.
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

@vertex
fn background_vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return whole_picture(index);
}

@fragment
fn background(@builtin(position) position: vec4f) -> @location(0) vec4f {
    if textureLoad(visible_triangles, vec2i(position.xy), 0).x != NO_TRIANGLE {
        discard;
    }
    let direction = normalize(view_direction(position.xy));
    return vec4f(min(environment(direction), vec3f(65504.0)), 1.0);
}

// What is shown: base layer + splat layer, tone-mapped and sRGB-encoded; or an overlay.
// The CPU pass is foveal::display::tone and of renderer::overlay; names as there.

struct Compose {
    // Reinhard's white; negative: clamp.
    white: f32,
    exposure: f32,
    // Overlay, and K of the lattice; in its highest bit whether there are refined pixels.
    overlay: u32,
    k_max: u32,
}

// Whether there is an overlay at all: software computes both sides of what it only knows when it draws.
override OVERLAID: bool = true;

@group(0) @binding(0) var<uniform> compose: Compose;
@group(0) @binding(1) var base: texture_2d<f32>;
// Splat layer with what lies between its samples: three halves of radiance and source + 1.
@group(0) @binding(2) var<storage, read> splats: array<vec2u>;
@group(0) @binding(3) var<storage, read> ranks: array<u32>;
@group(0) @binding(4) var objects: texture_2d<u32>;
@group(0) @binding(5) var textures: texture_2d<u32>;
// Radiance of refined pixels, and 1 + the error of their tile; alpha is 0 elsewhere.
@group(0) @binding(6) var refined: texture_2d<f32>;
// What the overlay shows of each object, in [0, 1]; of MIP_GIVEN the finest level of each texture.
@group(0) @binding(7) var<storage, read> values: array<f32>;

const SALIENCY: u32 = 1u;
const OBJECTS: u32 = 2u;
const LEVEL: u32 = 3u;
const AGE: u32 = 4u;
const TRACER: u32 = 5u;
const MIP: u32 = 6u;
const IMPORTANCE: u32 = 7u;
const PRIORITY: u32 = 8u;
const ERROR: u32 = 9u;
const MIP_GIVEN: u32 = 10u;
const K_LIMIT: u32 = 9u;
// Rank of a first approximation, which is no sample.
const APPROXIMATED: u32 = 1u;

@vertex
fn vertex(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    return vec4f(select(-1.0, 3.0, index == 1u), select(-1.0, 3.0, index == 2u), 0.0, 1.0);
}

fn luminance(rgb: vec3f) -> f32 {
    return dot(rgb, vec3f(0.2126729, 0.7151522, 0.0721750));
}

fn to_linear(radiance: vec3f) -> vec3f {
    var rgb = radiance * compose.exposure;
    if compose.white >= 0.0 {
        let l = luminance(rgb);
        if l > 0.0 {
            rgb *= (1.0 + l / max(compose.white * compose.white, 1.17549435e-38)) / (1.0 + l);
        }
    }
    return clamp(rgb, vec3f(0.0), vec3f(1.0));
}

fn srgb_from_linear(v: vec3f) -> vec3f {
    return select(1.055 * pow(v, vec3f(1.0 / 2.4)) - 0.055, 12.92 * v, v <= vec3f(0.0031308));
}

// A colour per number, far from those of its neighbours: the CPU pass is renderer::overlay::distinct.
fn distinct(n: u32) -> vec3f {
    let hue = f32((n * 40503u) & 0xffffu) / 65536.0;
    let k = fract(vec3f(hue) + vec3f(0.0, 2.0, 1.0) / 3.0) * 6.0 - 3.0;
    let pure = clamp(abs(k) - 1.0, vec3f(0.0), vec3f(1.0));
    return mix(vec3f(1.0), pure, 0.75) * (0.6 + 0.4 * f32((n * 7u) % 5u) / 4.0);
}

// Black, blue, red, yellow, white: the CPU pass is renderer::overlay::heat.
fn heat(v: f32) -> vec3f {
    let t = clamp(v, 0.0, 1.0) * 4.0;
    return clamp(vec3f(t - 1.0, t - 2.0, select(1.0 - abs(t - 1.0), t - 3.0, t > 2.0)), vec3f(0.0), vec3f(1.0));
}

@fragment
fn fragment(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let p = vec2i(position.xy);
    let pixel = p.y * i32(textureDimensions(base).x) + p.x;
    let packed = splats[pixel];
    let splat = vec4f(unpack2x16float(packed.x), unpack2x16float(packed.y));
    var radiance = textureLoad(base, p, 0).rgb + splat.rgb;
    var better = vec4f(0.0);
    if (compose.k_max >> 31u) != 0u {
        better = textureLoad(refined, p, 0);
        radiance = select(radiance, better.rgb, better.a > 0.5);
    }
    let shown = srgb_from_linear(to_linear(radiance));
    if !OVERLAID {
        return vec4f(shown, 1.0);
    }
    let object = textureLoad(objects, p, 0).x;
    let rank = ranks[pixel];
    let is_exact = rank == 0xffffffffu;
    let grey = vec3f(luminance(shown)) * 0.5;
    var color = grey;
    switch compose.overlay {
        case SALIENCY, IMPORTANCE, PRIORITY, ERROR: {
            if compose.overlay == ERROR && better.a > 0.5 {
                color = mix(grey, heat(better.a - 1.0), 0.7);
            } else if object != 0u && object < arrayLength(&values) {
                color = mix(grey, heat(values[object]), 0.7);
            }
        }
        case OBJECTS: {
            if object != 0u {
                color = mix(grey, distinct(object), 0.7);
            }
        }
        case LEVEL: {
            if rank > APPROXIMATED {
                let is_fresh = (rank & 0xffffu) == 0xffffu;
                // Without what a warped sample has on its own pixel.
                let fineness = ((rank & 0x7fffffffu) >> 16u) - 1u - select(0u, 1u, is_fresh);
                let k = select(K_LIMIT - min(fineness, K_LIMIT), 0u, is_exact);
                color = heat(1.0 - f32(k) / f32((compose.k_max & 0x7fffffffu) + 1u));
            }
        }
        case AGE: {
            if rank > APPROXIMATED {
                let age = select(0xffffu - (rank & 0xffffu), 0u, is_exact);
                color = heat(log2(f32(age) + 1.0) / 6.0);
                if age == 0u {
                    color = vec3f(0.0, 0.6, 0.2);
                }
            }
        }
        case TRACER: {
            if splat.a > 1.5 {
                color = mix(grey, distinct(u32(splat.a - 0.5)), 0.7);
            }
        }
        case MIP, MIP_GIVEN: {
            let word = textureLoad(textures, p, 0).x;
            if word != 0xffffffffu {
                var level = f32(word & 0xffu) / 8.0;
                let texture = word >> 8u;
                if compose.overlay == MIP_GIVEN && texture < arrayLength(&values) {
                    level = max(level, values[texture]);
                }
                color = mix(grey, heat(1.0 - level / 8.0), 0.7);
            }
        }
        default: {}
    }
    return vec4f(color, 1.0);
}

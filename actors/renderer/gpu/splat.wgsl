// The splat layer: instanced squares and tiles, which replace what has a lower or equal rank, on
// pixels of their object. Twin of foveal::splatting::layer; names as there.
//
// The rank is the depth that the rasteriser compares: ranks below 2^24 are exact in it.

struct Layer {
    // Picture width and height; largest k of the tile table.
    size: vec2u,
    k_max: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> layer: Layer;
// Per k: half side, first bit; then the bits of all tiles, rows one after another.
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var objects: texture_2d<u32>;
@group(0) @binding(3) var depths: texture_2d<f32>;

struct Splat {
    // Column in the low, row in the high half.
    @location(0) place: u32,
    @location(1) object: u32,
    @location(2) rank: f32,
    // Half side in the low byte, k in the next, source + 1 in the high half.
    @location(3) shape: u32,
    // Depth along the view axis and how far the depth buffer may differ.
    @location(4) depth: vec2f,
    @location(5) color: vec3f,
}

struct Vertex {
    @builtin(position) position: vec4f,
    @location(0) color: vec4f,
    @location(1) @interpolate(flat) object: u32,
    @location(2) @interpolate(flat) k: u32,
    @location(3) @interpolate(flat) center: vec2i,
}

fn center(splat: Splat) -> vec2i {
    return vec2i(i32(splat.place & 0xffffu), i32(splat.place >> 16u));
}

// A square of 2 half + 1 pixels around the splat's pixel; corner `index` of two triangles.
fn square(splat: Splat, index: u32, half: i32, rank: f32) -> Vertex {
    let right = index == 1u || index == 2u || index == 4u;
    let low = index == 2u || index == 4u || index == 5u;
    let c = center(splat);
    let x = c.x + select(-half, half + 1, right);
    let y = c.y + select(-half, half + 1, low);
    let ndc = vec2f(f32(x), f32(y)) / vec2f(layer.size) * 2.0 - 1.0;
    var out: Vertex;
    out.position = vec4f(ndc.x, -ndc.y, rank, 1.0);
    out.color = vec4f(min(splat.color, vec3f(65504.0)), f32(splat.shape >> 16u));
    out.object = splat.object;
    out.k = (splat.shape >> 8u) & 0xffu;
    out.center = c;
    return out;
}

@vertex
fn exact_vertex(@builtin(vertex_index) index: u32, splat: Splat) -> Vertex {
    return square(splat, index, 0, 1.0);
}

@vertex
fn fresh_vertex(@builtin(vertex_index) index: u32, splat: Splat) -> Vertex {
    let k = min((splat.shape >> 8u) & 0xffu, layer.k_max);
    return square(splat, index, i32(tiles[2u * k]), splat.rank);
}

fn matches(splat: Splat, x: i32, y: i32) -> bool {
    if x < 0 || y < 0 || x >= i32(layer.size.x) || y >= i32(layer.size.y) {
        return false;
    }
    let p = vec2i(x, y);
    return textureLoad(objects, p, 0).x == splat.object
        && abs(textureLoad(depths, p, 0).x - splat.depth.x) <= splat.depth.y;
}

@vertex
fn warped_vertex(@builtin(vertex_index) index: u32, splat: Splat) -> Vertex {
    let c = center(splat);
    var visible = matches(splat, c.x, c.y);
    for (var i = 0; i < 9 && !visible; i++) {
        visible = matches(splat, c.x + i % 3 - 1, c.y + i / 3 - 1);
    }
    var out = square(splat, index, i32(splat.shape & 0xffu), splat.rank);
    if !visible {
        // All corners in one point: no pixel is covered.
        out.position = vec4f(-2.0, -2.0, 0.0, 1.0);
    }
    return out;
}

@fragment
fn fragment(in: Vertex) -> @location(0) vec4f {
    if textureLoad(objects, vec2i(in.position.xy), 0).x != in.object {
        discard;
    }
    return in.color;
}

@fragment
fn tile_fragment(in: Vertex) -> @location(0) vec4f {
    let p = vec2i(in.position.xy);
    if textureLoad(objects, p, 0).x != in.object {
        discard;
    }
    let k = min(in.k, layer.k_max);
    let half = i32(tiles[2u * k]);
    let d = p - in.center + half;
    let bit = tiles[2u * k + 1u] + u32(d.y * (2 * half + 1) + d.x);
    let words = 2u * (layer.k_max + 1u);
    if ((tiles[words + (bit >> 5u)] >> (bit & 31u)) & 1u) == 0u {
        discard;
    }
    return in.color;
}

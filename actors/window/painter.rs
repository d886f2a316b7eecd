//! Paints egui's triangles on the processor, for windows without a graphics adapter.

use std::collections::BTreeMap;

use egui::epaint::{ClippedPrimitive, ImageData, Mesh, Primitive, Vertex};
use egui::{Color32, ColorImage, TextureFilter, TextureId, TexturesDelta};
use rayon::prelude::*;

/// Rows of the window that one thread paints at a time.
const BAND: usize = 32;

/// A texture and how it is enlarged.
#[derive(Debug)]
struct Texture {
    image: ColorImage,
    nearest: bool,
}

/// Textures of the interface, and the painting of its triangles.
#[derive(Debug, Default)]
pub struct SoftwarePainter {
    textures: BTreeMap<Key, Texture>,
}

/// [`TextureId`] with an order.
type Key = (bool, u64);

fn key(id: TextureId) -> Key {
    match id {
        TextureId::Managed(id) => (false, id),
        TextureId::User(id) => (true, id),
    }
}

impl SoftwarePainter {
    /// Takes new and changed textures.
    pub fn set_textures(&mut self, delta: &TexturesDelta) {
        for (id, changes) in &delta.set {
            for change in changes {
                let ImageData::Color(image) = &change.image;
                match (change.pos, self.textures.get_mut(&key(*id))) {
                    (Some(pos), Some(texture)) => patch(&mut texture.image, pos, image),
                    _ => {
                        let nearest = change.options.magnification == TextureFilter::Nearest;
                        self.textures.insert(key(*id), Texture { image: (**image).clone(), nearest });
                    }
                }
            }
        }
    }

    /// Forgets textures that are no longer used; after painting.
    pub fn free_textures(&mut self, delta: &TexturesDelta) {
        for id in &delta.free {
            self.textures.remove(&key(*id));
        }
    }

    /// Paints over `pixels`, `0x00RRGGBB` in rows of `size[0]`.
    pub fn paint(
        &self,
        primitives: &[ClippedPrimitive],
        pixels_per_point: f32,
        size: [usize; 2],
        pixels: &mut [u32],
    ) {
        let mut triangles = Vec::new();
        for primitive in primitives {
            let Primitive::Mesh(mesh) = &primitive.primitive else { continue };
            let Some(texture) = self.textures.get(&key(mesh.texture_id)) else { continue };
            let clip = primitive.clip_rect;
            let edge = |v: f32, n: usize| ((v * pixels_per_point).round().max(0.0) as usize).min(n);
            let clip = [
                edge(clip.min.x, size[0]),
                edge(clip.min.y, size[1]),
                edge(clip.max.x, size[0]),
                edge(clip.max.y, size[1]),
            ];
            place_mesh(mesh, texture, pixels_per_point, clip, &mut triangles);
        }
        // Each band is painted in the order of the whole, by one thread.
        let bands = pixels.par_chunks_mut((size[0] * BAND).max(1)).enumerate();
        bands.for_each(|(band, pixels)| {
            let first = band * BAND;
            for triangle in &triangles {
                triangle.paint(first, size[0], pixels);
            }
        });
    }
}

/// Replaces the part of `image` at `pos`, as far as it lies inside.
fn patch(image: &mut ColorImage, pos: [usize; 2], part: &ColorImage) {
    let [width, height] = image.size;
    let columns = part.size[0].min(width.saturating_sub(pos[0]));
    for row in 0..part.size[1].min(height.saturating_sub(pos[1])) {
        let to = (pos[1] + row) * width + pos[0];
        let from = row * part.size[0];
        image.pixels[to..to + columns].copy_from_slice(&part.pixels[from..from + columns]);
    }
}

/// A triangle in its place on the window.
struct Placed<'a> {
    /// Clockwise on a screen.
    corners: [Vertex; 3],
    /// Twice its area.
    area: f32,
    texture: &'a Texture,
    /// Columns and rows it may cover: first, and the one after the last.
    columns: [usize; 2],
    rows: [usize; 2],
    /// What all of it shows, where that is one colour: most of an interface is.
    source: Option<[f32; 4]>,
}

fn place_mesh<'a>(
    mesh: &Mesh,
    texture: &'a Texture,
    scale: f32,
    clip: [usize; 4],
    out: &mut Vec<Placed<'a>>,
) {
    for corners in mesh.indices.chunks_exact(3) {
        let corner = |i: usize| mesh.vertices.get(corners[i] as usize).copied();
        let (Some(a), Some(b), Some(c)) = (corner(0), corner(1), corner(2)) else { continue };
        let place = |mut v: Vertex| {
            v.pos.x *= scale;
            v.pos.y *= scale;
            v
        };
        let mut corners = [place(a), place(b), place(c)];
        let area = cross(corners[0], corners[1], corners[2].pos.x, corners[2].pos.y);
        if !area.is_finite() || area == 0.0 {
            continue;
        }
        if area < 0.0 {
            corners.swap(1, 2);
        }
        let low = |f: fn(&Vertex) -> f32, from: usize, to: usize| {
            let v = corners.iter().map(f).fold(f32::INFINITY, f32::min);
            (v.floor().max(0.0) as usize).clamp(from, to.max(from))
        };
        let high = |f: fn(&Vertex) -> f32, from: usize, to: usize| {
            let v = corners.iter().map(f).fold(f32::NEG_INFINITY, f32::max);
            (v.ceil().max(0.0) as usize).clamp(from, to.max(from))
        };
        let columns = [low(|v| v.pos.x, clip[0], clip[2]), high(|v| v.pos.x, clip[0], clip[2])];
        let rows = [low(|v| v.pos.y, clip[1], clip[3]), high(|v| v.pos.y, clip[1], clip[3])];
        let first = corners[0];
        let is_plain = corners.iter().all(|v| v.color == first.color && v.uv == first.uv);
        let source = is_plain
            .then(|| tinted(look_up(texture, first.uv.x, first.uv.y), first.color.to_array().map(f32::from)));
        out.push(Placed { corners, area: area.abs(), texture, columns, rows, source });
    }
}

/// Twice the signed area of (`a`, `b`, (`x`, `y`)), positive clockwise on a screen.
fn cross(a: Vertex, b: Vertex, x: f32, y: f32) -> f32 {
    (b.pos.x - a.pos.x) * (y - a.pos.y) - (b.pos.y - a.pos.y) * (x - a.pos.x)
}

impl Placed<'_> {
    /// Paints what lies in `pixels`: rows of `stride` from row `first` on.
    fn paint(&self, first: usize, stride: usize, pixels: &mut [u32]) {
        let t = &self.corners;
        let edges = [(t[1], t[2]), (t[2], t[0]), (t[0], t[1])];
        let owned = edges.map(|(a, b)| owns(a, b));
        let uniform = t.iter().all(|v| v.color == t[0].color);
        let last = first + pixels.len() / stride.max(1);
        for y in self.rows[0].max(first)..self.rows[1].min(last) {
            let py = y as f32 + 0.5;
            let [begin, end] = span(&edges, py, self.columns);
            let row = &mut pixels[(y - first) * stride..(y - first + 1) * stride];
            for (x, pixel) in row.iter_mut().enumerate().take(end).skip(begin) {
                let Some(w) = weights(&edges, owned, x as f32 + 0.5, py) else { continue };
                if let Some(source) = self.source {
                    *pixel = over(*pixel, source);
                    continue;
                }
                let w = w.map(|w| w / self.area);
                let u = w[0] * t[0].uv.x + w[1] * t[1].uv.x + w[2] * t[2].uv.x;
                let v = w[0] * t[0].uv.y + w[1] * t[1].uv.y + w[2] * t[2].uv.y;
                let texel = look_up(self.texture, u, v);
                let color = if uniform {
                    t[0].color.to_array().map(f32::from)
                } else {
                    let [a, b, c] = [0, 1, 2].map(|i: usize| t[i].color.to_array());
                    std::array::from_fn(|i| {
                        w[0] * f32::from(a[i]) + w[1] * f32::from(b[i]) + w[2] * f32::from(c[i])
                    })
                };
                *pixel = over(*pixel, tinted(texel, color));
            }
        }
    }
}

/// Whether a pixel centre on a shared edge is this triangle's: it is that of the one whose top or left edge it is.
fn owns(a: Vertex, b: Vertex) -> bool {
    (a.pos.y == b.pos.y && b.pos.x > a.pos.x) || b.pos.y < a.pos.y
}

/// Twice the areas that a point within the triangle makes with its edges.
fn weights(edges: &[(Vertex, Vertex); 3], owned: [bool; 3], x: f32, y: f32) -> Option<[f32; 3]> {
    let w = edges.map(|(a, b)| cross(a, b, x, y));
    (0..3).all(|i| w[i] > 0.0 || w[i] == 0.0 && owned[i]).then_some(w)
}

/// Columns of a row, out of `columns`, within which all pixels of a triangle lie, and few others.
fn span(edges: &[(Vertex, Vertex); 3], py: f32, columns: [usize; 2]) -> [usize; 2] {
    let (mut low, mut high) = (0.0f32, f32::INFINITY);
    for (a, b) in edges {
        let rise = b.pos.y - a.pos.y;
        // Where an edge is as good as level, rounding decides where it meets the row.
        if rise.abs() < 0.5 {
            continue;
        }
        let meets = a.pos.x + (b.pos.x - a.pos.x) * (py - a.pos.y) / rise;
        // The inside is to the right of edges that go up.
        if rise < 0.0 {
            low = low.max(meets - 1.5);
        } else {
            high = high.min(meets + 1.5);
        }
    }
    let [from, to] = columns;
    [(low as usize).clamp(from, to.max(from)), (high.max(0.0) as usize).clamp(from, to.max(from))]
}

/// A texel under a colour, both 0 to 255.
fn tinted(texel: [f32; 4], color: [f32; 4]) -> [f32; 4] {
    std::array::from_fn(|i| texel[i] * color[i] / 255.0)
}

/// Premultiplied `source` over an opaque pixel.
fn over(pixel: u32, source: [f32; 4]) -> u32 {
    let keep = 1.0 - source[3] / 255.0;
    let channel = |i: usize, shift: u32| {
        let below = ((pixel >> shift) & 0xff) as f32;
        ((source[i] + below * keep + 0.5) as u32).min(255) << shift
    };
    channel(0, 16) | channel(1, 8) | channel(2, 0)
}

/// A texel, 0 to 255, at coordinates from the upper left; beyond the rim the rim.
fn look_up(texture: &Texture, u: f32, v: f32) -> [f32; 4] {
    let [width, height] = texture.image.size;
    if width == 0 || height == 0 {
        return [0.0; 4];
    }
    let at = |x: usize, y: usize| texture.image.pixels[y * width + x];
    let (x, y) = (u * width as f32, v * height as f32);
    let inside = |v: f32, n: usize| (v.max(0.0) as usize).min(n - 1);
    if texture.nearest {
        return at(inside(x, width), inside(y, height)).to_array().map(f32::from);
    }
    let (x, y) = ((x - 0.5).max(0.0), (y - 0.5).max(0.0));
    let (x0, y0) = (inside(x, width), inside(y, height));
    let (x1, y1) = ((x0 + 1).min(width - 1), (y0 + 1).min(height - 1));
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let [a, b, c, d] =
        [at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1)].map(|c: Color32| c.to_array().map(f32::from));
    std::array::from_fn(|i| {
        let above = a[i] + (b[i] - a[i]) * fx;
        let below = c[i] + (d[i] - c[i]) * fx;
        above + (below - above) * fy
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use egui::epaint::ImageDelta;
    use egui::{Pos2, Rect, TextureOptions, pos2};

    fn painter(image: ColorImage, options: TextureOptions) -> SoftwarePainter {
        let mut painter = SoftwarePainter::default();
        let mut delta = TexturesDelta::default();
        delta.set.insert(TextureId::Managed(0), [ImageDelta::full(image, options)].into_iter().collect());
        painter.set_textures(&delta);
        delta.set.clear();
        painter
    }

    fn quad(rect: Rect, uv: Rect, color: Color32) -> ClippedPrimitive {
        let mut mesh = Mesh::with_texture(TextureId::Managed(0));
        mesh.add_rect_with_uv(rect, uv, color);
        ClippedPrimitive { clip_rect: Rect::EVERYTHING, primitive: Primitive::Mesh(mesh) }
    }

    const WHOLE: Rect = Rect { min: Pos2::ZERO, max: pos2(1.0, 1.0) };

    #[test]
    fn both_triangles_of_a_square_cover_each_pixel_once() {
        let painter = painter(ColorImage::filled([1, 1], Color32::WHITE), TextureOptions::LINEAR);
        let half = Color32::from_black_alpha(0).gamma_multiply(0.0);
        assert_eq!(half, Color32::TRANSPARENT);
        let grey = Color32::from_rgba_premultiplied(100, 50, 25, 128);
        for (x, y, side) in [(2.0, 3.0, 8.0), (2.5, 3.5, 7.0), (1.25, 1.75, 9.0)] {
            let mut pixels = vec![0u32; 16 * 16];
            let rect = Rect::from_min_size(pos2(x, y), egui::vec2(side, side));
            painter.paint(&[quad(rect, WHOLE, grey)], 1.0, [16, 16], &mut pixels);
            let covered = pixels.iter().filter(|p| **p != 0).count();
            assert_eq!(covered, (side * side) as usize, "a square at {x}, {y}");
            // Painted twice it would be brighter.
            assert!(pixels.iter().all(|p| *p == 0 || *p == 0x0064_3219));
        }
    }

    #[test]
    fn a_picture_shown_at_its_size_is_unchanged() {
        let colors: Vec<Color32> = (0..12u8).map(|i| Color32::from_rgb(i * 20, 255 - i, i)).collect();
        for options in [TextureOptions::LINEAR, TextureOptions::NEAREST] {
            let painter = painter(ColorImage::new([4, 3], colors.clone()), options);
            let mut pixels = vec![0u32; 6 * 5];
            let rect = Rect::from_min_size(pos2(1.0, 1.0), egui::vec2(4.0, 3.0));
            painter.paint(&[quad(rect, WHOLE, Color32::WHITE)], 1.0, [6, 5], &mut pixels);
            for (i, color) in colors.iter().enumerate() {
                let [r, g, b, _] = color.to_array().map(u32::from);
                assert_eq!(pixels[(1 + i / 4) * 6 + 1 + i % 4], r << 16 | g << 8 | b);
            }
            assert_eq!(pixels[0], 0);
        }
    }

    #[test]
    fn clipping_scaling_and_patches() {
        let mut painter = painter(ColorImage::filled([2, 2], Color32::WHITE), TextureOptions::NEAREST);
        let mut delta = TexturesDelta::default();
        let red = ColorImage::filled([1, 5], Color32::RED);
        let patch = ImageDelta::partial([1, 1], red, TextureOptions::NEAREST);
        delta.set.insert(TextureId::Managed(0), [patch].into_iter().collect());
        painter.set_textures(&delta);
        delta.set.clear();
        let mut shape = quad(Rect::from_min_size(Pos2::ZERO, egui::vec2(2.0, 2.0)), WHOLE, Color32::WHITE);
        shape.clip_rect = Rect::from_min_size(pos2(0.5, 0.0), egui::vec2(99.0, 99.0));
        let mut pixels = vec![0u32; 16];
        painter.paint(&[shape], 2.0, [4, 4], &mut pixels);
        let (w, r) = (0x00ff_ffff, 0x00ff_0000);
        assert_eq!(pixels, [0, w, w, w, 0, w, w, w, 0, w, r, r, 0, w, r, r]);
    }

    #[test]
    fn no_pixel_of_a_triangle_is_outside_of_its_span() {
        let vertex = |x: f32, y: f32| Vertex { pos: pos2(x, y), uv: Pos2::ZERO, color: Color32::WHITE };
        // Slivers about a point that is on no pixel's centre: steep edges, and some that are as good as level.
        let rim = 997;
        let at = |i: usize| {
            let turn = i as f32 / rim as f32 * std::f32::consts::TAU;
            vertex(70.3 + turn.cos() * 900.0, 51.7 + turn.sin() * 900.0)
        };
        let mut pixels = 0;
        for i in 0..rim {
            let t = [vertex(70.3, 51.7), at(i), at(i + 1)];
            let edges = [(t[1], t[2]), (t[2], t[0]), (t[0], t[1])];
            let owned = edges.map(|(a, b)| owns(a, b));
            for y in 0..100 {
                let py = y as f32 + 0.5;
                let [begin, end] = span(&edges, py, [0, 150]);
                let covers = |x: &usize| weights(&edges, owned, *x as f32 + 0.5, py).is_some();
                pixels += (begin..end).filter(covers).count();
                assert!(!(0..begin).chain(end..150).any(|x| covers(&x)), "row {y} of {i}: {begin}..{end}");
            }
        }
        // (Where rounding differs between two slivers a pixel may be of none or of both.)
        assert!((14_990..15_010).contains(&pixels), "{pixels}");
    }

    #[test]
    fn bands_meet() {
        let painter = painter(ColorImage::filled([1, 1], Color32::WHITE), TextureOptions::LINEAR);
        let (width, height) = (11, 3 * BAND + 7);
        let grey = Color32::from_rgba_premultiplied(100, 50, 25, 128);
        let rect = Rect::from_min_size(Pos2::ZERO, egui::vec2(width as f32, height as f32));
        let mut pixels = vec![0u32; width * height];
        painter.paint(&[quad(rect, WHOLE, grey)], 1.0, [width, height], &mut pixels);
        assert!(pixels.iter().all(|p| *p == 0x0064_3219));
    }

    #[test]
    fn nonsense_paints_nothing_and_does_not_panic() {
        let painter = painter(ColorImage::filled([1, 1], Color32::WHITE), TextureOptions::LINEAR);
        let mut pixels = vec![7u32; 16];
        for v in [f32::NAN, f32::INFINITY, f32::MAX] {
            let rect = Rect { min: pos2(v, -v), max: pos2(-v, v) };
            painter.paint(&[quad(rect, WHOLE, Color32::TRANSPARENT)], 1.0, [4, 4], &mut pixels);
        }
        assert!(pixels.iter().all(|p| *p == 7));
    }
}

//! Pictures where materials use them: which one, at which coordinates, and what is beyond its edges.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::Arc;

use glam::{Mat2, Vec2};

use super::buffers::{Buffers, Reference, shortened};
use super::document::{Document, TextureInfo, TextureTransform};
use super::number::Index;
use super::tangents::Along;
use super::{Oddities, Problem, get};
use foveal::math;
use foveal::scene::{Placement, Wrap};

/// A picture: where it is, or its bytes; what is wrong with it otherwise.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) enum Picture {
    /// A file of the scene's folder.
    File(PathBuf),
    /// From a buffer or a data URI.
    Bytes(Arc<Vec<u8>>),
    /// Completes "texture … ".
    Broken(String),
}

/// A picture on a surface.
#[derive(Clone, Debug, PartialEq)]
pub(in super::super) struct MapUse {
    /// For messages, and what makes it the same as another.
    pub name: String,
    pub picture: Picture,
    pub placement: Placement,
}

/// How coordinates of a file become those of the mesh: of which set, and moved how.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Coordinates {
    /// The set that is the mesh's first.
    pub set: usize,
    /// Linear part and offset, from the upper left; `None` where they stay.
    pub moved: Option<(Mat2, Vec2)>,
    /// Whether a map lies on the other set, which is the mesh's second then.
    pub both: bool,
    /// What tangents follow from, where the material needs some.
    pub along: Option<Along>,
}

impl Coordinates {
    /// The set of the first map, and the transform of all where they agree; where they do not, each map keeps its own.
    pub fn of<'i>(infos: impl Iterator<Item = &'i TextureInfo> + Clone, odd: &mut Oddities) -> Self {
        let Some(first) = infos.clone().next() else {
            return Self { set: 0, moved: None, both: false, along: None };
        };
        if infos.clone().any(|i| set(i) > 1) {
            odd.count("texture coordinates beyond the second set", "the second is used");
        }
        let number = |i: &TextureInfo| set(i).min(1) as usize;
        let moved = matrix(first);
        let agree = infos.clone().all(|i| matrix(i) == moved && number(i) == number(first));
        let stays = moved == (Mat2::IDENTITY, Vec2::ZERO);
        Self {
            set: number(first),
            moved: (agree && !stays).then_some(moved),
            both: infos.clone().any(|i| number(i) != number(first)),
            along: None,
        }
    }

    /// The same for a material whose normals or grooves lie as this map does, or as its first where there is none.
    pub fn with_tangents(self, of: Option<&TextureInfo>) -> Self {
        let along = of.map_or(Along { set: self.set, linear: Mat2::IDENTITY }, |info| Along {
            set: set(info).min(1) as usize,
            linear: matrix(info).0,
        });
        Self { along: Some(along), ..self }
    }

    /// Where a map lies on coordinates that have been moved so.
    fn placement(&self, info: &TextureInfo) -> Placement {
        let second = set(info).min(1) as usize != self.set;
        if self.moved.is_some() {
            return Placement { second, ..Placement::default() };
        }
        let (linear, offset) = matrix(info);
        let ([a, c], [b, d]) = (linear.x_axis.to_array(), linear.y_axis.to_array());
        // u' = a u + b w + x, w' = c u + d w + y from the upper left; v = 1 − w.
        Placement {
            scale_offset: [a, d, offset.x + b, 1.0 - d - offset.y],
            // Without the sign of a zero.
            shear: [0.0 - b, 0.0 - c],
            second,
            ..Placement::default()
        }
    }
}

fn transform(info: &TextureInfo) -> Option<&TextureTransform> {
    info.extensions.transform.as_ref()
}

fn set(info: &TextureInfo) -> u32 {
    transform(info).and_then(|t| t.tex_coord).unwrap_or(info.tex_coord).0
}

/// uv' = T · R · S · uv, in coordinates from the upper left. A turn by a positive angle is counter-clockwise to the eye.
fn matrix(info: &TextureInfo) -> (Mat2, Vec2) {
    let Some(t) = transform(info) else { return (Mat2::IDENTITY, Vec2::ZERO) };
    let (s, c) = if t.rotation == 0.0 { (0.0, 1.0) } else { math::sin_cos(t.rotation) };
    let [x, y] = t.scale;
    let linear = Mat2::from_cols(Vec2::new(c * x, -s * x), Vec2::new(s * y, c * y));
    let offset = Vec2::from(t.offset);
    if linear.is_finite() && offset.is_finite() { (linear, offset) } else { (Mat2::IDENTITY, Vec2::ZERO) }
}

/// The pictures of a document, each looked up once.
pub(super) struct Pictures<'a> {
    document: &'a Document,
    known: HashMap<u32, (String, Picture)>,
}

impl<'a> Pictures<'a> {
    pub fn new(document: &'a Document) -> Self {
        Self { document, known: HashMap::new() }
    }

    pub fn map_use(
        &mut self,
        info: &TextureInfo,
        coordinates: &Coordinates,
        buffers: &mut Buffers<'_>,
        odd: &mut Oddities,
    ) -> Result<MapUse, Problem> {
        const NEAREST: u32 = 9728;
        let texture = get(&self.document.textures, info.index, "textures")?;
        let mut placement = coordinates.placement(info);
        if let Some(sampler) = texture.sampler {
            let sampler = get(&self.document.samplers, sampler, "samplers")?;
            placement.wrap = [sampler.wrap_s, sampler.wrap_t].map(|w| wrap(w, odd));
            placement.nearest = sampler.mag_filter == Some(Index(NEAREST));
        }
        let webp = texture.extensions.webp.as_ref().and_then(|w| w.source);
        let basisu = texture.extensions.basisu.as_ref().and_then(|b| b.source);
        let source = basisu.filter(|_| cfg!(feature = "basisu")).or(webp).or(texture.source);
        let Some(source) = source else {
            let why = match texture.extensions.basisu {
                None => "has no picture that this build reads",
                Some(_) => {
                    "is compressed by Basis Universal, which this build does not read (export it again as PNG or JPEG)"
                }
            };
            let picture = Picture::Broken(why.to_owned());
            return Ok(MapUse { name: format!("texture {}", info.index.0), picture, placement });
        };
        if !self.known.contains_key(&source.0) {
            let found = self.picture(source, buffers)?;
            self.known.insert(source.0, found);
        }
        let (name, picture) = self.known[&source.0].clone();
        Ok(MapUse { name, picture, placement })
    }

    /// A picture and its name.
    pub fn picture(&self, source: Index, buffers: &mut Buffers<'_>) -> Result<(String, Picture), Problem> {
        let image = get(&self.document.images, source, "images")?;
        let number = format!("image {}", source.0);
        Ok(match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                let name = if uri.starts_with("data:") { number } else { shortened(uri) };
                let picture = match buffers.resolve(uri) {
                    Ok(Reference::File(found)) => Picture::File(found),
                    Ok(Reference::Data(bytes)) => Picture::Bytes(Arc::new(bytes)),
                    Err(why) => Picture::Broken(why),
                };
                (name, picture)
            }
            (None, Some(view)) => {
                let (bytes, _) = buffers.view(view)?;
                (number, Picture::Bytes(Arc::new(bytes.to_vec())))
            }
            (None, None) => (number, Picture::Broken("names neither file nor bytes".to_owned())),
        })
    }
}

fn wrap(mode: Option<Index>, odd: &mut Oddities) -> Wrap {
    match mode.map_or(10_497, |m| m.0) {
        10_497 => Wrap::Repeat,
        33_071 => Wrap::Clamp,
        33_648 => Wrap::Mirror,
        _ => {
            odd.count("an unknown way to go on beyond a picture's edge", "repeated");
            Wrap::Repeat
        }
    }
}

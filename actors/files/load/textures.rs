//! Pictures: which are asked for, and their decoding within limits.

use std::collections::{HashMap, HashSet};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec3;
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use rayon::prelude::*;

use super::LoadOptions;
use super::ahead::{Ahead, Key, Picture};
use super::error::{FileProblem, Place, Warning};
use super::folder::{Contents, Folder, read_file};
use super::mtl::MapStatement;
use foveal::image::Map2d;
use foveal::scene::texture::MipChain;
use foveal::scene::texture::Pixels;
use foveal::scene::{Placement, Texture, TextureId};

/// A picture that a material asks for.
struct Request {
    /// As written.
    name: String,
    /// Where it is, or why it is nowhere.
    found: Result<PathBuf, String>,
    asked_by: Place,
    is_color: bool,
    placement: Placement,
}

/// All pictures that are asked for. Their ids are places in this list until [`Self::load`].
#[derive(Default)]
pub(super) struct TextureRequests {
    list: Vec<Request>,
    known: HashMap<RequestKey, u32>,
    /// Pictures that are no files, by what stands for their path.
    in_memory: HashMap<PathBuf, Arc<Vec<u8>>>,
}

/// What makes two requests the same: where the picture is, or its name where it is nowhere, and how
/// it is read.
type RequestKey = (PathBuf, bool, bool, [u32; 7]);

impl TextureRequests {
    /// Asks for a picture of `folder`, looked for in `bases` in turn.
    pub fn ask(
        &mut self,
        folder: &Folder,
        bases: &[&Path],
        map: &MapStatement,
        is_color: bool,
        asked_by: Place,
    ) -> TextureId {
        let mut found = Err(FileProblem::Missing);
        for base in bases {
            found = folder.find(base, &map.file);
            if found != Err(FileProblem::Missing) {
                break;
            }
        }
        let found = found.map_err(|p| p.to_string());
        let placement = Placement { scale_offset: map.scale_offset, ..Placement::clamped(map.clamp) };
        self.ask_for(&map.file, found, None, is_color, placement, asked_by)
    }

    /// Asks for a picture that is at `found` (or nowhere, for the reason given), or in `bytes`, for which `found` stands.
    pub fn ask_for(
        &mut self,
        name: &str,
        found: Result<PathBuf, String>,
        bytes: Option<Arc<Vec<u8>>>,
        is_color: bool,
        placement: Placement,
        asked_by: Place,
    ) -> TextureId {
        let (place, there) = match &found {
            Ok(path) => (path.clone(), true),
            Err(_) => (PathBuf::from(name), false),
        };
        if let Some(bytes) = bytes {
            self.in_memory.insert(place.clone(), bytes);
        }
        let key = (place, there, is_color, placement.bits());
        let id = self.list.len() as u32;
        if let Some(&known) = self.known.get(&key) {
            return TextureId(known);
        }
        self.known.insert(key, id);
        self.list.push(Request { name: name.to_owned(), found, asked_by, is_color, placement });
        TextureId(id)
    }

    /// Reads and decodes all of them in parallel. Returns the textures, which have their finest levels only until they are
    /// completed, and for each id of
    /// [`Self::ask`] the final one, or `None` where there is a warning instead.
    pub fn load(
        self,
        folder: &mut Folder,
        mut ahead: Ahead,
        options: &LoadOptions,
        warnings: &mut Vec<Warning>,
    ) -> (Vec<Texture>, Vec<Option<TextureId>>) {
        // One decoding for all requests of a file that read it the same way.
        let mut jobs: Vec<Key> = Vec::new();
        let mut job_of: HashMap<Key, usize> = HashMap::new();
        let of_request: Vec<Option<usize>> = self
            .list
            .iter()
            .map(|r| {
                let key = (r.found.clone().ok()?, r.is_color);
                Some(*job_of.entry(key.clone()).or_insert_with(|| {
                    jobs.push(key);
                    jobs.len() - 1
                }))
            })
            .collect();
        let made: Vec<Option<Picture>> = jobs.iter().map(|key| ahead.take(key)).collect();
        let files: Vec<Result<(Encoded, u64), String>> = jobs
            .par_iter()
            .zip(made)
            .map(|((path, _), made)| match made {
                Some(picture) => {
                    let bytes = picture.bytes;
                    Ok((Encoded::Made(picture), bytes))
                }
                None => open(path, self.in_memory.get(path), options),
            })
            .collect();
        // The sum is bounded in the order of the list, so that the same ones are kept every time.
        let mut left = options.texture_bytes_max;
        let files: Vec<Result<Encoded, String>> = files
            .into_iter()
            .map(|f| {
                let (contents, bytes) = f?;
                if bytes > left {
                    return Err(format!(
                        "is one too many: all together may take {} bytes",
                        options.texture_bytes_max
                    ));
                }
                left -= bytes;
                Ok(contents)
            })
            .collect();
        for ((path, _), file) in jobs.iter().zip(&files) {
            // What is in memory lies in files that were noted when they were read.
            if let Ok(Encoded::File(Contents { hash, .. }) | Encoded::Made(Picture { hash, .. })) = file {
                folder.note(folder.relative(path), *hash);
            }
        }
        let decoded: Vec<Result<(Arc<MipChain>, bool), String>> = jobs
            .par_iter()
            .zip(files)
            .map(|((path, is_color), file)| {
                let (mips, alpha) = match &file? {
                    Encoded::File(contents) => decode(&contents.bytes, path, *is_color, options)?,
                    Encoded::Memory(bytes) => decode(bytes, path, *is_color, options)?,
                    Encoded::Made(picture) => return picture.made.clone(),
                };
                Ok((Arc::new(mips), alpha))
            })
            .collect();
        let checker = checker();
        let mut textures = Vec::new();
        let mut ids = Vec::with_capacity(self.list.len());
        let mut said: HashSet<&str> = HashSet::new();
        for (r, job) in self.list.iter().zip(&of_request) {
            let outcome = match job {
                Some(j) => decoded[*j].clone(),
                None => Err(r.found.as_ref().err().cloned().unwrap_or_default()),
            };
            match outcome {
                Ok((mips, has_alpha)) => {
                    let path = r.found.as_ref().map_or(Path::new(&r.name), PathBuf::as_path);
                    let name = if self.in_memory.contains_key(path) {
                        r.name.clone()
                    } else {
                        folder.relative(path)
                    };
                    textures.push(Texture {
                        name,
                        mips,
                        has_alpha,
                        is_color: r.is_color,
                        placement: r.placement,
                    });
                    ids.push(Some(TextureId(textures.len() as u32 - 1)));
                }
                Err(why) => {
                    // What is looked at shows that something is missing; masks and normals would deform things.
                    if r.is_color {
                        textures.push(Texture::new(r.name.clone(), checker.clone()));
                        ids.push(Some(TextureId(textures.len() as u32 - 1)));
                    } else {
                        ids.push(None);
                    }
                    if said.insert(&r.name) {
                        let instead =
                            if r.is_color { "a checker is shown instead" } else { "it is left out" };
                        let message = format!("texture \"{}\" {why}; {instead}", r.name);
                        warnings.push(Warning::new(r.asked_by.clone(), message));
                    }
                }
            }
        }
        (textures, ids)
    }
}

/// Light grey and magenta squares, in the place of a picture that cannot be shown.
fn checker() -> MipChain {
    let square =
        |i: usize| if (i % 8 + i / 8).is_multiple_of(2) { [200, 200, 200, 255] } else { [200, 40, 180, 255] };
    MipChain::from_rgba8(8, 8, (0..64).map(square).collect(), true)
}

/// A reader that knows the format, by content or else by name.
fn reader<'a>(bytes: &'a [u8], path: &Path) -> Result<ImageReader<Cursor<&'a [u8]>>, String> {
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| format!("cannot be read: {e}"))?;
    if reader.format().is_none() {
        // TGA has no mark at its start.
        let format = ImageFormat::from_path(path).map_err(|_| "is of no known picture format".to_owned())?;
        reader.set_format(format);
    }
    Ok(reader)
}

/// A picture's bytes, or what was made of them already.
enum Encoded {
    File(Contents),
    Memory(Arc<Vec<u8>>),
    Made(Picture),
}

/// Reads a file, where the picture is not in memory, and, from its header alone, how many bytes its pixels will take.
fn open(path: &Path, kept: Option<&Arc<Vec<u8>>>, options: &LoadOptions) -> Result<(Encoded, u64), String> {
    if let Some(encoded) = kept {
        let bytes = pixel_bytes(encoded, path, options)?;
        return Ok((Encoded::Memory(encoded.clone()), bytes));
    }
    let contents = read_file(path, options.file_bytes_max).map_err(|p| p.to_string())?;
    let bytes = pixel_bytes(&contents.bytes, path, options)?;
    Ok((Encoded::File(contents), bytes))
}

/// Columns and rows, from the header alone.
fn size(bytes: &[u8], path: &Path, options: &LoadOptions) -> Result<(u32, u32), String> {
    #[cfg(feature = "basisu")]
    if super::ktx2::is_ktx2(bytes) {
        return super::ktx2::size(bytes);
    }
    let mut r = reader(bytes, path)?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(options.picture_bytes_max);
    r.limits(limits);
    r.into_dimensions().map_err(|e| format!("is no readable picture: {e}"))
}

/// Bytes that a picture's pixels will take, from its header alone, or why it is too large.
pub(super) fn pixel_bytes(bytes: &[u8], path: &Path, options: &LoadOptions) -> Result<u64, String> {
    let (w, h) = size(bytes, path, options)?;
    let side = options.texture_side_max;
    if w > side || h > side {
        return Err(format!("declares {w} × {h} pixels, more than {side} on a side"));
    }
    if w == 0 || h == 0 {
        return Err("has no pixels".to_owned());
    }
    let bytes = u64::from(w) * u64::from(h) * 4;
    if bytes > options.picture_bytes_max {
        let limit = options.picture_bytes_max;
        return Err(format!("declares {w} × {h} pixels, more than fit into {limit} bytes"));
    }
    Ok(bytes)
}

/// Decodes within the limits; the header has been checked.
fn pixels(bytes: &[u8], path: &Path, options: &LoadOptions) -> Result<DynamicImage, String> {
    pixel_bytes(bytes, path, options)?;
    #[cfg(feature = "basisu")]
    if super::ktx2::is_ktx2(bytes) {
        return super::ktx2::decode(bytes);
    }
    let mut r = reader(bytes, path)?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(options.texture_side_max);
    limits.max_image_height = Some(options.texture_side_max);
    limits.max_alloc = Some(options.picture_bytes_max);
    r.limits(limits);
    let broken = |e| format!("is broken: {e}");
    let decoder = r.into_decoder().map_err(broken)?;
    if decoder.total_bytes() > options.picture_bytes_max {
        return Err(format!(
            "needs {} bytes, more than {}",
            decoder.total_bytes(),
            options.picture_bytes_max
        ));
    }
    DynamicImage::from_decoder(decoder).map_err(broken)
}

/// A picture, the finest level of its chain alone, and whether it has an alpha channel.
pub(super) fn decode(
    bytes: &[u8],
    path: &Path,
    is_color: bool,
    options: &LoadOptions,
) -> Result<(MipChain, bool), String> {
    let image = pixels(bytes, path, options)?;
    let (w, h) = (image.width() as usize, image.height() as usize);
    let alpha = image.color().has_alpha();
    let pixels = match image.color() {
        ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 if !is_color => {
            Pixels::Word(image.into_rgba16().pixels().map(|p| p.0).collect())
        }
        ColorType::Rgb32F | ColorType::Rgba32F => {
            let clean = |v: f32| if v.is_finite() { v.max(0.0) } else { 0.0 };
            Pixels::Float(image.into_rgba32f().pixels().map(|p| p.0.map(clean)).collect())
        }
        _ => {
            let bytes = image.into_rgba8().into_raw();
            // Where the bytes lie already, unless there is room left behind them.
            let texels =
                bytemuck::try_cast_vec(bytes).unwrap_or_else(|(_, bytes)| bytes.as_chunks::<4>().0.to_vec());
            Pixels::Byte { texels, gamma: is_color }
        }
    };
    Ok((MipChain::alone(w, h, pixels), alpha))
}

/// Decodes a face of a cube map: with an alpha channel, colours are divided by it (RGBD), else they are as bright as they look.
pub(super) fn radiance_face(bytes: &[u8], path: &Path, options: &LoadOptions) -> Result<Map2d<Vec3>, String> {
    // Six of them are held at once.
    let options = LoadOptions { picture_bytes_max: options.picture_bytes_max / 8, ..options.clone() };
    let image = pixels(bytes, path, &options)?;
    let (width, height, has_alpha) = (image.width(), image.height(), image.color().has_alpha());
    let texel = |p: &image::Rgba<u8>| {
        let [r, g, b, a] = p.0;
        let divisor = if has_alpha { f32::from(a.max(1)) / 255.0 } else { 1.0 };
        Vec3::from([r, g, b].map(|v| foveal::image::linear_from_srgb(f32::from(v) / 255.0))) / divisor
    };
    let texels = image.into_rgba8().pixels().map(texel).collect();
    Ok(Map2d::from_vec(width as usize, height as usize, texels))
}

/// Decodes an equirectangular map. Returns the number of texels that were no radiance (negative,
/// NaN or infinite) and were set to 0, or to the largest half float where they were infinite.
pub(super) fn radiance_map(
    bytes: &[u8],
    path: &Path,
    options: &LoadOptions,
) -> Result<(Map2d<Vec3>, usize), String> {
    let format = reader(bytes, path)?.format();
    if !matches!(format, Some(ImageFormat::Hdr | ImageFormat::OpenExr)) {
        return Err("is neither Radiance (.hdr) nor OpenEXR (.exr)".to_owned());
    }
    let image = pixels(bytes, path, options)?.into_rgb32f();
    let (w, h) = (image.width() as usize, image.height() as usize);
    let mut bad = 0;
    let texels = image
        .pixels()
        .map(|p| {
            let v = Vec3::from(p.0);
            if v.is_finite() && v.min_element() >= 0.0 {
                return v;
            }
            bad += 1;
            // 65504: the largest half float, what an overflow while writing stood for.
            Vec3::from(p.0.map(|c| if c.is_nan() { 0.0 } else { c.clamp(0.0, 65_504.0) }))
        })
        .collect();
    Ok((Map2d::from_vec(w, h, texels), bad))
}

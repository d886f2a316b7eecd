//! A scene's textures under a limit: what is known of each, and where its levels are kept on disk.

use std::path::{Path, PathBuf};

use crossbeam_queue::ArrayQueue;
use foveal::allocation::residency::{TextureFacts, smallest};
use foveal::allocation::spatial_error::{SpatialErrors, SpatialSettings, TexelDifference};
use foveal::perception::viewing::{pixels_per_degree_of_camera, pixels_per_degree_of_screen};
use foveal::scene::texture::{LevelTexels, MipChain};
use foveal::scene::{Model, Scene, Texture, Wrap};
use foveal_files::mips;
use rayon::prelude::*;
use std::sync::Arc;

/// What a texture asked for and was given: a line of the bill.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Charge {
    /// Pixels that show it.
    pub pixels: f32,
    /// The finest level asked for; `None` where nobody sees it.
    pub asked: Option<usize>,
    /// The finest level in memory or ordered to be.
    pub given: usize,
    /// Visible error of the difference, just noticeable differences × pixels.
    pub loss: f64,
}

/// Textures at a moment.
#[derive(Clone, Debug)]
pub struct TextureReport {
    /// Bytes by the allocator's count: in memory, on their way there, or dropped and perhaps still held.
    pub used: u64,
    /// Bytes of texels that the process held.
    pub held: u64,
    /// Visible error that one more MiB would take away.
    pub price_per_mib: f64,
    /// Levels loaded and drops ordered so far.
    pub counts: [u32; 2],
    /// By texture.
    pub bill: Vec<Charge>,
}

impl TextureReport {
    /// −Σ q, just noticeable differences × pixels.
    pub fn visible_error(&self) -> f64 {
        self.bill.iter().map(|charge| charge.loss).sum()
    }
}

/// Textures that do not fit into their limit.
#[derive(Debug)]
pub struct TextureStore {
    /// Bytes that may be in memory.
    pub limit: u64,
    /// By texture.
    pub facts: Vec<TextureFacts>,
    /// T̃, mean luminance of each.
    pub means: Vec<f32>,
    /// Content of each, which names its files.
    contents: Vec<[u8; 32]>,
    folder: PathBuf,
    /// What the allocator did last, for whoever wants to know; nobody decides by it.
    pub report: ArrayQueue<TextureReport>,
    /// What could not be kept on disk; levels of these cannot come back once they are dropped.
    pub warnings: Vec<String>,
}

/// Why textures cannot be limited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BelowSmallest {
    /// The smallest limit that works.
    pub smallest: u64,
}

impl TextureStore {
    /// Measures all textures of a scene (in memory in full), keeps their levels in `folder`, and returns the textures with
    /// nothing but their coarsest levels, those that decide geometry in full.
    ///
    /// # Errors
    /// Where not even these fit into `limit`.
    pub fn new(scene: &Scene, limit: u64, folder: &Path) -> Result<(Self, Vec<Texture>), BelowSmallest> {
        let pinned = decisive(scene);
        let picture = scene.cameras.first().map_or(1.0, |c| c.camera.fov_y);
        let pixels_per_degree = match scene.display.screen {
            Some(s) => pixels_per_degree_of_screen(s.pixels as usize, s.width, s.distance),
            None => pixels_per_degree_of_camera(512, picture),
        };
        let difference = if scene.display.lab { TexelDifference::Lab } else { TexelDifference::Luminance };
        let settings = SpatialSettings {
            difference,
            ..SpatialSettings::new(pixels_per_degree, scene.display.white_cd_m2)
        };
        let measured: Vec<(TextureFacts, [u8; 32], Option<String>)> = scene
            .textures
            .par_iter()
            .enumerate()
            .map(|(i, texture)| {
                let content = texture.mips.content_hash();
                let problem = mips::keep(folder, &content, &texture.mips).err().map(|e| {
                    format!("{}: its levels cannot be kept in {}: {e}", texture.name, folder.display())
                });
                let spatial = measured_before(folder, &content, texture, &settings);
                let bytes = (0..texture.level_count()).map(|l| texture.mips.level_bytes(l) as u64).collect();
                (TextureFacts { bytes, pinned: pinned[i], spatial }, content, problem)
            })
            .collect();
        let mut store = Self {
            limit,
            facts: Vec::new(),
            means: Vec::new(),
            contents: Vec::new(),
            folder: folder.to_owned(),
            report: ArrayQueue::new(1),
            warnings: Vec::new(),
        };
        for (facts, content, problem) in measured {
            store.means.push(facts.spatial.mean_luminance());
            store.facts.push(facts);
            store.contents.push(content);
            store.warnings.extend(problem);
        }
        let smallest = smallest(&store.facts);
        if smallest > limit {
            return Err(BelowSmallest { smallest });
        }
        let reduced = |(texture, facts): (&Texture, &TextureFacts)| Texture {
            mips: Arc::new(texture.mips.without_finer(facts.coarsest())),
            ..texture.clone()
        };
        let textures = scene.textures.iter().zip(&store.facts).map(reduced).collect();
        Ok((store, textures))
    }

    /// Where a level is kept.
    pub fn file(&self, texture: usize, level: usize) -> PathBuf {
        mips::level_file(&self.folder, &self.contents[texture], level)
    }

    /// A level, of texels like those of another one.
    ///
    /// # Errors
    /// If its file cannot be read, or is not whole.
    pub fn level(&self, texture: usize, level: usize, like: &LevelTexels) -> std::io::Result<LevelTexels> {
        let bytes = self.facts.get(texture).and_then(|facts| facts.bytes.get(level)).copied().unwrap_or(0);
        mips::read(&self.file(texture, level), bytes as usize, like)
    }

    /// A texture's chain with finer levels, as far as `finest`; `None` where one cannot be had.
    pub fn refined(&self, texture: usize, chain: &MipChain, finest: usize) -> Option<MipChain> {
        let like = chain.level(chain.level_count() - 1)?;
        (finest..chain.finest())
            .rev()
            .try_fold(chain.clone(), |chain, level| chain.with_finer(self.level(texture, level, like).ok()?))
    }

    /// What names a level in a recording.
    pub fn digest(&self, texture: usize) -> u64 {
        let [a, b, c, d, e, f, g, h, ..] = self.contents[texture];
        u64::from_le_bytes([a, b, c, d, e, f, g, h])
    }
}

/// Which textures decide where surfaces are and which way they face: masks, heights and normals.
pub fn decisive(scene: &Scene) -> Vec<bool> {
    let mut decisive = vec![false; scene.textures.len()];
    for material in &scene.materials {
        // What a lobe's width comes from is no picture whose levels could be told apart by looking at it.
        let lobe = match &material.model {
            Model::MetalRough(m) if m.roughness_in_alpha => m.specular.map,
            _ => None,
        };
        let through = match &material.model {
            Model::MetalRough(m) => m.through.map,
            _ => material.tint.map,
        };
        let others = [material.opacity_map, material.bump_map, material.normal_map, lobe, through];
        let shown = material.picture();
        let read = material.maps_by_point().into_iter().filter(|map| Some(*map) != shown);
        for map in others.into_iter().flatten().chain(read) {
            decisive[map.0 as usize] = true;
        }
    }
    decisive
}

/// The spatial errors of a texture, from the folder or measured and kept there.
fn measured_before(
    folder: &Path,
    content: &[u8; 32],
    texture: &Texture,
    s: &SpatialSettings,
) -> SpatialErrors {
    let mut key = blake3::Hasher::new();
    key.update(content);
    key.update(&[1, u8::from(texture.placement.wrap != [Wrap::Repeat; 2]), s.difference as u8]);
    key.update(&s.pixels_per_degree.to_le_bytes());
    key.update(&s.white_cd_m2.to_le_bytes());
    let file = folder.join(format!("{}.fvspat", &key.finalize().to_hex()[..32]));
    let kept = std::fs::read(&file).ok().and_then(|bytes| postcard::from_bytes::<SpatialErrors>(&bytes).ok());
    if let Some(kept) = kept.filter(|kept| kept.levels() == texture.level_count()) {
        return kept;
    }
    let measured = SpatialErrors::of_texture(texture, s);
    if let Ok(bytes) = postcard::to_stdvec(&measured) {
        // Only time is lost where it cannot be kept.
        let _ = std::fs::write(&file, bytes);
    }
    measured
}

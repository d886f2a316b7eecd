//! What a walk and a guest (a machine that traces for it) tell each other: postcard, one message at a time, each of bounded
//! length.
//!
//! Both sides may be hostile. What is decoded here is bounded by the bytes that came, before anything is allocated, and
//! every number that indexes something has been compared with what it indexes, or says who compares it.

use foveal::allocation::jobs::{GUIDES, SampleJob};
use foveal::display::cpu_pass::CELLS;
use foveal::sampling::Lattice;
use foveal::scene::camera::CameraFrame;
use foveal::splatting::light_tracing::Splats;
use foveal::splatting::supersampling::{Block, TILE, Tiles};
use foveal::splatting::tile_sums::TileSums;
use foveal::transport::caustic::RUN;
use glam::Vec3;
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

/// Changes with every change of a message.
pub const PROTOCOL: u16 = 6;
/// Most bytes of a message.
pub const MESSAGE_BYTES_MAX: usize = 2 << 20;
/// Most bytes of one piece of a blob.
pub const PIECE_BYTES_MAX: usize = 256 << 10;
/// Most jobs of one message, and answers.
pub const JOBS_MAX: usize = 512;
/// Most samples of one job that is sent.
pub const SAMPLES_MAX: u32 = 1 << 14;
/// Largest side of a picture, as recordings have it.
pub const SIDE_MAX: u32 = 16_384;
/// Most bytes that say what a piece of work is, or what pieces are of.
pub const WORK_BYTES_MAX: usize = 128 << 10;
/// Most bytes of names and versions.
const NAME_BYTES_MAX: usize = 128;
/// Brightest colour that a sample may have.
const COLOR_MAX: f32 = 1e9;

/// The lease of a piece of a round.
pub fn lease_of(round: u32, piece: u32) -> u64 {
    u64::from(round) << 32 | u64::from(piece)
}

/// The round that a piece of work belongs to.
pub fn round_of(lease: u64) -> u32 {
    (lease >> 32) as u32
}

/// A blob's BLAKE3.
pub type Hash = [u8; 32];

/// From a walk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToGuest {
    /// The guest may come: this is what it needs.
    Welcome {
        /// Names its stay: what it says goes with it.
        incarnation: u64,
        /// The package, a blob.
        package: Hash,
        /// Bytes of that.
        bytes: u64,
        /// K of the walk's √5 lattice.
        k_max: u32,
    },
    /// It may not, or no longer.
    Refused(Refusal),
    /// A part of a blob, from `at` on.
    Piece {
        /// Which blob.
        hash: Hash,
        /// Where the part begins.
        at: u64,
        /// Bytes of it.
        #[serde(with = "serde_bytes_like")]
        bytes: Vec<u8>,
    },
    /// A view that jobs may name from now on.
    View(ViewSpec),
    /// Jobs.
    Jobs(Vec<JobSpec>),
    /// Whoever has not begun a job of an older view, or a piece of work of an older round, need not.
    Retire {
        /// The first view or round that counts.
        below: u32,
    },
    /// What pieces of work are of, from now on.
    Ground {
        /// Names it.
        number: u32,
        /// The task, as whoever does it takes it.
        #[serde(with = "serde_bytes_like")]
        task: Vec<u8>,
        /// The light that it is done under: a blob, and its bytes.
        map: Option<(Hash, u64)>,
    },
    /// A piece of work.
    Work {
        /// Names it in the answer; its upper half is the round that it belongs to.
        lease: u64,
        /// What it is of.
        ground: u32,
        /// Which, as whoever does it takes it.
        #[serde(with = "serde_bytes_like")]
        piece: Vec<u8>,
    },
    /// The walk ends.
    Farewell,
}

/// Why a guest is not wanted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// It speaks another protocol, or is of another version.
    Version {
        /// What the walk is.
        wanted: String,
    },
    /// Its numbers have other bits.
    OtherBits {
        /// Those of the walk.
        wanted: u64,
    },
    /// It has less memory than the scene's files take.
    TooSmall {
        /// Bytes of these.
        bytes: u64,
    },
    /// Every place is taken.
    Full,
    /// It sent what makes no sense, or colours that are not those of the scene.
    Banned,
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Version { wanted } => write!(f, "the walk is of {wanted}, this is another version"),
            Self::OtherBits { wanted } => {
                write!(f, "numbers have other bits here than on the walk's machine ({wanted:016x})")
            }
            Self::TooSmall { bytes } => {
                write!(f, "the scene's files are {bytes} bytes, more than this machine has for it (--memory)")
            }
            Self::Full => write!(f, "the walk has no place free"),
            Self::Banned => write!(f, "the walk has banned this machine: it sent what is not in the scene"),
        }
    }
}

/// What a view is made of, beside the package: the bits of the walk's own camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewSpec {
    /// Which view.
    pub view: u32,
    /// Its camera.
    pub frame: CameraFrame,
    /// How densely it is drawn, as `FrameBuffers::cell` says.
    pub cell: u32,
}

/// A job.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct JobSpec {
    /// Names it in the answer.
    pub lease: u64,
    /// The view it is for.
    pub view: u32,
    /// What to trace.
    pub order: Order,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// What a job traces.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Order {
    /// These samples, or guides.
    Samples(SampleJob),
    /// More samples of each pixel of a tile.
    Block(Block),
    /// A run of light traced to the eye.
    Run(u32),
}

impl Order {
    /// Samples of it, at most.
    pub fn samples(&self) -> u32 {
        match self {
            Self::Samples(job) => job.count,
            Self::Block(block) => block.count * TILE * TILE,
            Self::Run(_) => RUN as u32,
        }
    }
}

/// From a guest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromGuest {
    /// The first word.
    Hello {
        /// [`PROTOCOL`].
        protocol: u16,
        /// Program and version.
        program: String,
        /// What its mathematical functions give ([`super::bits::probe`]).
        bits: u64,
        /// Cores that trace.
        cores: u16,
        /// Its name, for people.
        name: String,
        /// Bytes of memory that it has for a scene, if it has said so.
        memory: Option<u64>,
    },
    /// It wants a part of a blob, from `at` on.
    Want {
        /// Which blob.
        hash: Hash,
        /// Where the part begins.
        at: u64,
    },
    /// It has the scene, and may be given jobs.
    Ready {
        /// Its stay.
        incarnation: u64,
    },
    /// Jobs are done.
    Done {
        /// Its stay.
        incarnation: u64,
        /// Which, and what was found.
        jobs: Vec<DoneJob>,
    },
    /// It has what pieces of work are of.
    Grounded {
        /// Its stay.
        incarnation: u64,
        /// Which.
        number: u32,
    },
    /// A piece of work is done.
    Worked {
        /// Its stay.
        incarnation: u64,
        /// Which.
        lease: u64,
        /// Time of one core, µs.
        micros: u32,
        /// Pieces that it has and nobody there has begun.
        waiting: u32,
        /// What was found; nothing where it could not be done.
        #[serde(with = "serde_bytes_like")]
        found: Vec<u8>,
    },
    /// It leaves; what it has not answered, it will not.
    Leaving,
}

/// The answer to a job.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DoneJob {
    /// The job.
    pub lease: u64,
    /// Time of one core, µs.
    pub micros: u32,
    /// What was found; none where it was not begun.
    pub found: Option<Body>,
}

/// What a job comes to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Body {
    /// Of samples, or guides.
    Colors(Colors),
    /// Of a block.
    Block(TileSums),
    /// Of a run.
    Run(Splats),
}

impl Body {
    /// Whether it is what light can come to.
    pub fn is_sound(&self) -> bool {
        match self {
            Self::Colors(colors) => colors.is_sound(),
            Self::Block(sums) => sums.is_sound(),
            Self::Run(splats) => splats.is_sound(),
        }
    }

    /// Samples, guides, or particles.
    pub fn samples(&self) -> u32 {
        match self {
            Self::Colors(colors) => colors.colors.len() as u32,
            Self::Block(sums) => sums.samples.saturating_mul(sums.len() as u32),
            Self::Run(_) => RUN as u32,
        }
    }

    /// Bytes of it in a message, about.
    pub fn size_bytes(&self) -> usize {
        match self {
            Self::Colors(colors) => size_of::<Vec3>() * (colors.colors.len() + colors.guides.len()),
            Self::Block(sums) => sums.size_bytes(),
            Self::Run(splats) => splats.size_bytes(),
        }
    }

    /// Its hash.
    pub fn digest(&self) -> u64 {
        match self {
            Self::Colors(colors) => {
                let mut h = Xxh3::new();
                for color in colors.colors.iter().chain(&colors.guides) {
                    color.to_array().iter().for_each(|v| h.update(&v.to_bits().to_le_bytes()));
                }
                h.digest()
            }
            Self::Block(sums) => sums.digest(),
            Self::Run(splats) => splats.digest(),
        }
    }
}

/// Colours, in the order of the job's pixels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Colors {
    /// Of samples; of guides where the job was one of guides.
    pub colors: Vec<Vec3>,
    /// Of the guides of these samples, where they were asked for.
    pub guides: Vec<Vec3>,
}

impl Colors {
    /// Whether all are colours that light can have.
    pub fn is_sound(&self) -> bool {
        let sound = |c: &Vec3| c.is_finite() && c.abs().max_element() <= COLOR_MAX;
        self.colors.iter().chain(&self.guides).all(sound)
    }
}

/// Bytes as bytes, not as a list of numbers.
mod serde_bytes_like {
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(bytes: &[u8], s: S) -> Result<S::Ok, S::Error> {
        s.serialize_bytes(bytes)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Vec<u8>, D::Error> {
        <&[u8]>::deserialize(d).map(<[u8]>::to_vec)
    }
}

fn is_view(v: &ViewSpec) -> bool {
    let CameraFrame { eye, forward, right, up, size } = v.frame;
    CELLS.contains(&v.cell)
        && size.iter().all(|side| (1..=SIDE_MAX).contains(side))
        && [eye, forward, right, up].iter().all(|vector| vector.is_finite())
}

impl JobSpec {
    /// Whether it lies in a picture of this size, and can be done by whoever has it.
    pub fn fits(&self, lattice: &Lattice, size: [u32; 2]) -> bool {
        let order = match self.order {
            Order::Samples(order) => order,
            Order::Block(block) => return block.fits(&Tiles::of_size(size[0], size[1])),
            Order::Run(_) => return true,
        };
        let SampleJob { object: _, level, guided: _, rect, start, count } = order;
        let [width, height] = size.map(|side| side as i32);
        let is_inside = 0 <= rect.x0 && rect.x0 <= rect.x1 && rect.x1 <= width;
        let is_inside = is_inside && 0 <= rect.y0 && rect.y0 <= rect.y1 && rect.y1 <= height;
        let begins = (0..=width).contains(&start.x) && (0..=height).contains(&start.y);
        is_inside && begins && count <= SAMPLES_MAX && (level == GUIDES || level <= lattice.levels())
    }
}

impl ToGuest {
    /// As bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// From bytes; none where they are not a message that a walk sends.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        let (message, rest) = decoded::<Self>(bytes)?;
        let sound = match &message {
            Self::Welcome { k_max, .. } => *k_max <= Lattice::K_LIMIT,
            Self::Refused(Refusal::Version { wanted }) => wanted.len() <= NAME_BYTES_MAX,
            Self::Piece { bytes, .. } => bytes.len() <= PIECE_BYTES_MAX,
            Self::View(view) => is_view(view),
            Self::Jobs(jobs) => jobs.len() <= JOBS_MAX,
            Self::Ground { task, .. } => task.len() <= WORK_BYTES_MAX,
            Self::Work { piece, .. } => piece.len() <= WORK_BYTES_MAX,
            Self::Refused(_) | Self::Retire { .. } | Self::Farewell => true,
        };
        (sound && rest.is_empty()).then_some(message)
    }
}

impl FromGuest {
    /// As bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// From bytes; none where they are not a message that a guest sends.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        let (message, rest) = decoded::<Self>(bytes)?;
        let sound = match &message {
            Self::Hello { program, name, cores, .. } => {
                program.len() <= NAME_BYTES_MAX && name.len() <= NAME_BYTES_MAX && (1..=1024).contains(cores)
            }
            Self::Done { jobs, .. } => jobs.len() <= JOBS_MAX,
            Self::Want { .. }
            | Self::Ready { .. }
            | Self::Grounded { .. }
            | Self::Worked { .. }
            | Self::Leaving => true,
        };
        (sound && rest.is_empty()).then_some(message)
    }
}

/// Lists are read element by element, each of which takes at least a byte of what came, and serde reserves no more than a
/// mebibyte ahead.
fn decoded<'b, T: Deserialize<'b>>(bytes: &'b [u8]) -> Option<(T, &'b [u8])> {
    if bytes.len() > MESSAGE_BYTES_MAX {
        return None;
    }
    postcard::take_from_bytes(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use foveal::sampling::{Cursor, Rect};
    use proptest::prelude::*;

    fn job(rect: Rect, start: Cursor, level: u32, count: u32) -> JobSpec {
        let order = SampleJob { object: 1, level, guided: false, rect, start, count };
        JobSpec { lease: 7, view: 3, order: Order::Samples(order), seed: 9 }
    }

    #[test]
    fn messages_come_as_they_were_sent() {
        let spec = job(Rect { x0: 1, y0: 2, x1: 9, y1: 8 }, Cursor { x: 1, y: 2 }, 2, 5);
        for message in [
            ToGuest::Refused(Refusal::Full),
            ToGuest::Jobs(vec![spec; 3]),
            ToGuest::Piece { hash: [3; 32], at: 5, bytes: vec![1; 1000] },
            ToGuest::Retire { below: 4 },
            ToGuest::Farewell,
        ] {
            assert_eq!(ToGuest::of_bytes(&message.to_bytes()), Some(message));
        }
        let colors = vec![Vec3::new(0.25, 1e-20, 3.0); 256];
        let found = Some(Body::Colors(Colors { colors, guides: Vec::new() }));
        let done = FromGuest::Done { incarnation: 5, jobs: vec![DoneJob { lease: 7, micros: 2000, found }] };
        let bytes = done.to_bytes();
        assert!(bytes.len() as f32 <= 12.5 * 256.0, "{} bytes for 256 samples", bytes.len());
        assert_eq!(FromGuest::of_bytes(&bytes), Some(done));
    }

    #[test]
    fn what_cannot_be_done_is_refused() {
        let lattice = Lattice::new(6, [32, 24]);
        let (rect, start) = (Rect { x0: 0, y0: 0, x1: 64, y1: 48 }, Cursor { x: 0, y: 0 });
        let fits = |rect, start, level, count| job(rect, start, level, count).fits(&lattice, [64, 48]);
        assert!(fits(rect, start, 7, SAMPLES_MAX) && fits(rect, start, GUIDES, 1));
        assert!(!fits(rect, start, 8, 1) && !fits(rect, start, 7, SAMPLES_MAX + 1));
        assert!(!fits(Rect { x1: 65, ..rect }, start, 7, 1) && !fits(Rect { x0: -1, ..rect }, start, 7, 1));
        assert!(!fits(rect, Cursor { x: 0, y: -1 }, 7, 1) && !fits(rect, Cursor { x: 0, y: i32::MAX }, 7, 1));
        let frame =
            CameraFrame { eye: Vec3::ZERO, forward: Vec3::Z, right: Vec3::X, up: Vec3::Y, size: [64, 48] };
        let view =
            |frame, cell| ToGuest::of_bytes(&ToGuest::View(ViewSpec { view: 1, frame, cell }).to_bytes());
        assert!(view(frame, 2).is_some() && view(frame, 4).is_some() && view(frame, 3).is_none());
        assert!(view(CameraFrame { eye: Vec3::NAN, ..frame }, 1).is_none());
        assert!(view(CameraFrame { size: [0, 48], ..frame }, 1).is_none());
        assert!(view(CameraFrame { size: [1 << 20, 48], ..frame }, 1).is_none());
        let colors = |color| Colors { colors: vec![Vec3::ONE, color], guides: Vec::new() };
        assert!(colors(Vec3::ONE).is_sound() && !colors(Vec3::NAN).is_sound());
        assert!(!colors(Vec3::splat(f32::INFINITY)).is_sound() && !colors(Vec3::splat(1e10)).is_sound());
    }

    proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = ToGuest::of_bytes(&bytes);
            let _ = FromGuest::of_bytes(&bytes);
        }
    }
}

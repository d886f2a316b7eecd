//! Messages between a walk and a guest with random edits, given to whoever reads them: each side is hostile to the other.

use bolero::{TypeGenerator, check};
use foveal::allocation::jobs::SampleJob;
use foveal::display::cpu_pass::CELLS;
use foveal::sampling::{Cursor, Lattice, Rect};
use foveal::scene::camera::CameraFrame;
use foveal::splatting::light_tracing::Splats;
use foveal::splatting::supersampling::{BLOCK, Block, Tiles};
use foveal::splatting::tile_sums::TileSums;
use foveal_actors::station::wire::*;
use foveal_remote::key::{Invitation, Key};
use foveal_remote::package::{Entry, FILES_MAX, Manifest};
use glam::Vec3;

#[derive(Clone, Debug, TypeGenerator)]
enum Edit {
    Flip { at: u16, bit: u8 },
    Insert { at: u16, bytes: Vec<u8> },
    Remove { at: u16, count: u8 },
    Cut { at: u16 },
}

fn edited(message: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut bytes = message.to_vec();
    for edit in edits.iter().take(16) {
        let place = |at: u16| ((bytes.len() as u64 * u64::from(at)) >> 16) as usize;
        match edit {
            Edit::Flip { at, bit } => {
                let at = place(*at);
                if let Some(byte) = bytes.get_mut(at) {
                    *byte ^= 1 << (bit % 8);
                }
            }
            Edit::Insert { at, bytes: new } => {
                let at = place(*at);
                bytes.splice(at..at, new.iter().copied());
            }
            Edit::Remove { at, count } => {
                let at = place(*at);
                let end = (at + usize::from(*count)).min(bytes.len());
                bytes.drain(at..end);
            }
            Edit::Cut { at } => bytes.truncate(place(*at)),
        }
    }
    bytes
}

fn of_walk() -> Vec<Vec<u8>> {
    let frame =
        CameraFrame { eye: Vec3::ZERO, forward: Vec3::Z, right: Vec3::X, up: Vec3::Y, size: [512, 512] };
    let rect = Rect { x0: 0, y0: 0, x1: 64, y1: 64 };
    let order =
        SampleJob { object: 3, level: 5, guided: true, rect, start: Cursor { x: 7, y: 9 }, count: 256 };
    let job = JobSpec { lease: 1 << 40, view: 3, order: Order::Samples(order), seed: 11 };
    let block = Block { tile: 1023, first: 16, count: BLOCK };
    let refining = JobSpec { order: Order::Block(block), ..job };
    let said = [
        ToGuest::Welcome { incarnation: 3, package: [7; 32], bytes: 1000, k_max: 6 },
        ToGuest::Refused(Refusal::Version { wanted: "foveal 0.1.0 protocol 1".into() }),
        ToGuest::Piece { hash: [9; 32], at: 1 << 20, bytes: vec![5; 400] },
        ToGuest::View(ViewSpec { view: 3, frame, cell: 2 }),
        ToGuest::View(ViewSpec { view: 4, frame, cell: 4 }),
        ToGuest::Jobs(vec![job; 8]),
        ToGuest::Jobs(vec![refining; 8]),
        ToGuest::Retire { below: 3 },
        ToGuest::Ground { number: 4, task: vec![3; 60], map: Some(([8; 32], 1 << 22)) },
        ToGuest::Work { lease: lease_of(5, 6), ground: 4, piece: vec![7; 300] },
    ];
    said.iter().map(ToGuest::to_bytes).collect()
}

fn of_guest() -> Vec<Vec<u8>> {
    let found = Body::Colors(Colors { colors: vec![Vec3::ONE; 40], guides: vec![Vec3::X; 40] });
    let done = DoneJob { lease: 1 << 40, micros: 2000, found: Some(found) };
    let found = Some(Body::Block(TileSums::block(7, 20, 16)));
    let refined = DoneJob { lease: 1 << 40, micros: 50_000, found };
    let said = [
        FromGuest::Hello {
            protocol: 1,
            program: "foveal".into(),
            bits: 5,
            cores: 16,
            name: "a machine".into(),
            memory: Some(1 << 33),
        },
        FromGuest::Want { hash: [1; 32], at: 1 << 30 },
        FromGuest::Ready { incarnation: 3 },
        FromGuest::Done { incarnation: 3, jobs: vec![done, DoneJob::default()] },
        FromGuest::Done { incarnation: 3, jobs: vec![refined] },
        FromGuest::Grounded { incarnation: 3, number: 4 },
        FromGuest::Worked {
            incarnation: 3,
            lease: lease_of(5, 6),
            micros: 900,
            waiting: 1,
            found: vec![9; 400],
        },
    ];
    said.iter().map(FromGuest::to_bytes).collect()
}

#[test]
fn what_a_walk_says() {
    let corpus = of_walk();
    assert!(corpus.iter().all(|message| ToGuest::of_bytes(message).is_some()));
    check!().with_type::<(u8, Vec<Edit>)>().for_each(|(which, edits)| {
        let message = edited(&corpus[usize::from(*which) % corpus.len()], edits);
        match ToGuest::of_bytes(&message) {
            Some(ToGuest::View(view)) => {
                assert!(view.frame.size.iter().all(|side| (1..=SIDE_MAX).contains(side)));
                assert!(CELLS.contains(&view.cell) && view.frame.eye.is_finite());
            }
            Some(ToGuest::Jobs(jobs)) => {
                assert!(jobs.len() <= JOBS_MAX);
                let lattice = Lattice::new(6, [256, 256]);
                for job in jobs.iter().filter(|job| job.fits(&lattice, [512, 512])) {
                    let order = match &job.order {
                        Order::Samples(order) => order,
                        Order::Block(block) => {
                            let inside = |&(x, y): &(usize, usize)| x < 512 && y < 512;
                            assert!(block.pixels([512, 512]).iter().all(inside) && block.count <= BLOCK);
                            assert!(block.first < foveal::splatting::supersampling::SAMPLES_MAX);
                            continue;
                        }
                        Order::Run(_) => continue,
                    };
                    assert!(order.rect.x1 <= 512 && order.rect.y1 <= 512 && order.count <= SAMPLES_MAX);
                    // Whoever does it comes to an end, and looks at no pixel outside.
                    let at = |x: i32, y: i32| u32::from(x >= 0 && y >= 0 && x < 512 && y < 512) * 3;
                    let pixels = foveal::allocation::jobs::pixels_as_told(&lattice, order, at);
                    assert!(pixels.len() <= SAMPLES_MAX as usize);
                    assert!(pixels.iter().all(|&(x, y)| (0..512).contains(&x) && (0..512).contains(&y)));
                }
            }
            Some(ToGuest::Piece { bytes, .. }) => assert!(bytes.len() <= PIECE_BYTES_MAX),
            _ => {}
        }
    });
}

#[test]
fn what_a_guest_says() {
    let corpus = of_guest();
    assert!(corpus.iter().all(|message| FromGuest::of_bytes(message).is_some()));
    check!().with_type::<(u8, Vec<Edit>)>().for_each(|(which, edits)| {
        let message = edited(&corpus[usize::from(*which) % corpus.len()], edits);
        if let Some(FromGuest::Done { jobs, .. }) = FromGuest::of_bytes(&message) {
            let numbers = |body: &Body| match body {
                Body::Colors(colors) => 3 * (colors.colors.len() + colors.guides.len()),
                Body::Block(sums) => (sums.size_bytes() - size_of::<TileSums>()) / 4,
                // A pixel's number may take a byte, its colours take 24.
                Body::Run(splats) => (splats.size_bytes() - size_of::<Splats>()) / 28 * 6,
            };
            let all: usize = jobs.iter().flat_map(|job| &job.found).map(numbers).sum();
            assert!(jobs.len() <= JOBS_MAX && 4 * all <= message.len());
            let tiles = Tiles::of_size(512, 512);
            for body in jobs.iter().flat_map(|job| &job.found) {
                let _ = (body.is_sound(), body.samples(), body.digest());
                if let Body::Block(sums) = body {
                    // Whoever would join it has asked that first.
                    assert!(!sums.fits_as_block(&tiles) || sums.len() as u64 == tiles.rect(sums.tile).area());
                }
            }
        }
    });
}

#[test]
fn lists_of_files_and_keys() {
    let entry = |name: &str| Entry { name: name.into(), hash: [1; 32], bytes: 77 };
    let manifest = Manifest {
        scene: "a.obj".into(),
        files: ["a.obj", "a.mtl", "maps/wood.png"].map(entry).to_vec(),
        light: "{}".into(),
        illumination: Some((entry("illumination"), "none".into())),
        content_hash: [2; 32],
    };
    let key = Invitation { address: "tcp/127.0.0.1:7447".into(), key: Key::new().expect("randomness") };
    let corpus = [postcard::to_stdvec(&manifest).expect("bytes"), key.to_string().into_bytes()];
    check!().with_type::<(bool, Vec<Edit>)>().for_each(|(which, edits)| {
        let bytes = edited(&corpus[usize::from(*which)], edits);
        if let Some(manifest) = Manifest::of_bytes(&bytes) {
            assert!(manifest.files.len() <= FILES_MAX);
            let parts =
                |entry: &Entry| entry.name.split(['/', '\\']).all(|part| part != ".." && !part.is_empty());
            assert!(manifest.files.iter().all(parts), "{:?}", manifest.files);
        }
        let _ = String::from_utf8_lossy(&bytes).parse::<Invitation>();
    });
}

//! `--tracers`: other machines that trace for a walk.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use foveal_actors::station::wire::Hash;
use foveal_actors::station::{STATIONS_MAX, Stands, StationStatus};
use foveal_engine::batch::{Alone, Hands};
use foveal_engine::failure::Failure;
use foveal_engine::interrupt::interrupted;
use foveal_engine::light::Reading;
use foveal_engine::recording::TRACERS_MAX;
use foveal_engine::{Engine, Opened, Options, Settings};
use foveal_remote::door::{Door, Letting};
use foveal_remote::hands::{Helped, HelperStatus};
use foveal_remote::key::{Invitation, Key};
use foveal_remote::package::Package;
use foveal_terminal::arguments::one_of;
use serde_json::{Value, json};

/// Where other machines come, and which.
#[derive(Args, Clone, Debug)]
struct DoorArguments {
    /// Have other machines trace as well: listens at quic/ADDRESS:PORT, or at tcp/ADDRESS:PORT of this machine alone, for
    /// `foveal trace`; a walk's light is baked first
    #[arg(long, value_name = "ADDRESS")]
    tracers: Option<String>,
    /// File for the key they join with (made, or used again; default: printed)
    #[arg(long, value_name = "FILE", requires = "tracers")]
    tracers_key: Option<PathBuf>,
    /// The most machines at once
    #[arg(long, value_name = "N", default_value_t = STATIONS_MAX, requires = "tracers", value_parser = clap::value_parser!(u32).range(1..=i64::from(STATIONS_MAX)))]
    tracers_max: u32,
    /// How much of what comes from there is traced here as well and compared: 1/64 is one sample in 64
    #[arg(long, value_name = "1/N", default_value = "1/64", requires = "tracers", value_parser = one_of)]
    check: u32,
}

/// Arguments of commands that other machines can trace for.
#[derive(Args, Clone, Debug)]
pub struct TracersArguments {
    #[command(flatten)]
    door: DoorArguments,
    /// Let machines join whose results differ in their last bits: what they trace is recorded, and close to what would be
    /// traced here, not the same
    #[arg(long, requires = "tracers")]
    any_bits: bool,
    /// Record what other machines trace, so that a replay need not trace it again
    #[arg(long, requires = "tracers")]
    tracers_payloads: bool,
}

impl TracersArguments {
    /// Where to listen for other machines, if they may come.
    #[cfg(any(feature = "serve", feature = "window"))]
    pub(super) fn address(&self) -> Option<&str> {
        self.door.tracers.as_deref()
    }

    /// Whether other machines may come.
    pub fn is_asked_for(&self) -> bool {
        self.door.tracers.is_some()
    }

    /// Places for them.
    pub fn settings(&self, settings: Settings) -> Settings {
        let stations = if self.is_asked_for() { self.door.tracers_max } else { 0 };
        let tracers = settings.tracers.min(TRACERS_MAX + 1 - stations);
        Settings { stations, tracers, checked: self.door.check, ..settings }
    }

    /// What is granted who comes, and kept of it.
    pub(super) fn letting(&self) -> Letting {
        Letting { any_bits: self.any_bits, payloads: self.tracers_payloads }
    }

    /// Opens the door, if one was asked for.
    pub fn open(
        &self,
        opened: &Opened,
        settings: &Settings,
        options: &mut Options,
    ) -> Result<Option<Door>, Failure> {
        let Some(address) = &self.door.tracers else { return Ok(None) };
        let door = self.door(address, Package::of(opened)?, settings)?;
        options.outlets = Some(door.outlets());
        Ok(Some(door))
    }

    /// Opens it at an address, and tells others how to come.
    pub(super) fn door(&self, address: &str, package: Package, settings: &Settings) -> Result<Door, Failure> {
        let (key, letting) = (self.door.key()?, self.letting());
        let door = Door::open(address, key, package, settings.k_max, settings.stations, letting)?;
        self.door.invite(door.invitation())?;
        Ok(door)
    }

    /// Has guests lead to the walk, and waits for as many as are wanted.
    pub fn attach(&self, door: Option<&Door>, guests: u32, engine: &mut Engine) -> Result<(), Failure> {
        let Some(door) = door else { return Ok(()) };
        door.attach(engine.station_inputs());
        until(|| door.serving() >= guests)
    }
}

impl DoorArguments {
    /// What others join with: what the file says, or a new one.
    fn key(&self) -> Result<Key, Failure> {
        match &self.tracers_key {
            Some(file) if file.exists() => Ok(read(file)?.key),
            _ => Key::new().map_err(Failure::Environment),
        }
    }

    /// Tells others how to come.
    fn invite(&self, invitation: &Invitation) -> Result<(), Failure> {
        match &self.tracers_key {
            Some(file) => write(file, invitation),
            None => {
                invite(invitation);
                Ok(())
            }
        }
    }
}

/// Waits for other machines.
fn until(they_are_there: impl Fn() -> bool) -> Result<(), Failure> {
    while !they_are_there() {
        if interrupted() {
            return Err(Failure::Interrupted("interrupted while waiting for other machines".into()));
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Ok(())
}

/// Arguments of commands whose work other machines can do in pieces.
#[derive(Args, Clone, Debug)]
pub struct HelpersArguments {
    #[command(flatten)]
    door: DoorArguments,
    /// Begin once so many machines are there
    #[arg(long, value_name = "N", default_value_t = 0, requires = "tracers", value_parser = clap::value_parser!(u32).range(0..=i64::from(STATIONS_MAX)))]
    tracers_wait: u32,
}

impl HelpersArguments {
    /// Whether other machines may help.
    pub fn are_asked_for(&self) -> bool {
        self.door.tracers.is_some()
    }

    /// Opens the door for them, if one was asked for, and waits for as many as are wanted.
    pub fn open(
        &self,
        scene: &Path,
        reading: &Reading,
        content_hash: Hash,
    ) -> Result<Option<Helped>, Failure> {
        let Some(address) = &self.door.tracers else { return Ok(None) };
        let package = Package::without_light(scene, reading, content_hash)?;
        let helped =
            Helped::open(address, self.door.key()?, package, self.door.tracers_max, self.door.check)?;
        self.door.invite(helped.invitation())?;
        until(|| helped.serving() >= self.tracers_wait)?;
        Ok(Some(helped))
    }
}

/// Who does pieces of work.
pub fn hands(helped: Option<&Helped>) -> &dyn Hands {
    helped.map_or(&Alone, |helped| helped)
}

/// What became of the work of each machine that came.
pub fn helpers_document(helpers: &[HelperStatus]) -> Value {
    let helper = |h: &HelperStatus| {
        json!({
            "guest": h.name,
            "cores": h.cores,
            "pieces": h.pieces,
            "busy_seconds": h.busy,
            "late": h.late,
            "returned": h.returned,
            "checked": h.checked,
            "banned": h.banned,
        })
    };
    helpers.iter().map(helper).collect()
}

/// A walk prints its results on standard output; this is none.
#[expect(clippy::print_stderr, reason = "what others need to come")]
fn invite(invitation: &Invitation) {
    eprintln!("other machines come with: foveal trace --join {invitation}");
}

/// An invitation from a file.
pub fn read(file: &Path) -> Result<Invitation, Failure> {
    let wrong = |what: String| Failure::Input(format!("{}: {what}", file.display()));
    let long = std::fs::metadata(file).map_err(|e| wrong(e.to_string()))?.len() > 4096;
    if long {
        return Err(wrong("this is no key".into()));
    }
    std::fs::read_to_string(file).map_err(|e| wrong(e.to_string()))?.parse().map_err(wrong)
}

/// Into a file that nobody else reads.
fn write(file: &Path, invitation: &Invitation) -> Result<(), Failure> {
    let wrong = |e: std::io::Error| Failure::Environment(format!("{}: {e}", file.display()));
    let mut options = std::fs::OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut out = options.open(file).map_err(wrong)?;
    writeln!(out, "{invitation}").map_err(wrong)
}

/// The stations of a walk that has come to rest, those that had a guest.
pub fn document(stations: &[StationStatus]) -> Value {
    let station = |(number, s): (usize, &StationStatus)| {
        let StationStatus { guest, other_bits, cores, stands, rate, jobs, round_trip, counts } = s;
        json!({
            "station": number,
            "guest": guest,
            "other_bits": other_bits,
            "cores": cores,
            "state": stands.name(),
            "suspect": *stands == Stands::Suspect,
            "samples_per_second": rate,
            "credits": jobs[1],
            "round_trip_ms": f64::from(*round_trip) * 1e3,
            "samples": counts.samples,
            "jobs": counts.jobs,
            "late": counts.late,
            "returned": counts.returned,
            "shared": counts.shared,
            "checked": counts.checked,
            "banned": counts.banned,
        })
    };
    let used = |(_, s): &(usize, &StationStatus)| s.guest.is_some() || s.counts != Default::default();
    stations.iter().enumerate().filter(used).map(station).collect()
}

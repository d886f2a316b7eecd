//! One who looks: what was sent and not yet drawn, what may be sent next, how much may be asked for.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::sync::Arc;

use foveal_engine::source::Controls;
use foveal_engine::thread::{Report, Shown};

use crate::coding::Coding;
use crate::flow::{PageClock, Quality, Rate};
use crate::gate::Pass;
use crate::protocol::Role;

/// Names a connection.
pub type ViewerId = u64;
/// Names a walk.
pub type RoomId = u64;

/// Frames, and bytes of them, that may be on their way to a viewer.
const FRAMES: usize = 2;
const BYTES: usize = 2 << 20;
/// How long a picture must be the same before it is sent without loss, seconds.
const STILL: f64 = 0.25;
/// Shortest time between two reports, seconds.
const REPORT: f64 = 0.25;

/// Whether somebody has said who they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// Not yet.
    Greeting,
    /// In this walk, and may do so much there.
    In(RoomId, Pass),
}

/// A frame on its way.
#[derive(Clone, Copy, Debug)]
struct Sent {
    number: u32,
    at: f64,
    bytes: usize,
    lossless: bool,
}

/// What a viewer was told last of who drives.
pub type Told = (Role, bool, usize);

/// One who looks.
#[derive(Debug)]
pub struct Viewer {
    /// Where the connection comes from.
    pub address: IpAddr,
    /// Whether it was let in.
    pub standing: Standing,
    /// By this it is known if the connection is lost.
    pub resume: String,
    /// When it came, and when it was last heard.
    pub heard: f64,
    /// The page's clock.
    pub clock: PageClock,
    /// Messages of input, single events, settings, deeds.
    pub rates: [Rate; 4],
    /// How often it has said that something is set.
    pub set: u64,
    /// What was said of who drives.
    pub told: Option<Told>,
    /// What was said of the picture: its number, whether it is exact, and after which setting.
    pub still: Option<(u64, bool, u64)>,
    /// A picture is being coded for it.
    pub waits: bool,
    /// A file is on its way.
    pub fetches: bool,
    /// When it was last sent a frame.
    pub served: f64,
    quality: Quality,
    /// Bytes a second.
    limit: Option<Rate>,
    sent: VecDeque<Sent>,
    /// What it sees once all is drawn, and whether each bit of that is right.
    sees: Option<(Arc<Shown>, bool)>,
    report: Option<(Arc<Report>, f64)>,
    values: Option<Controls>,
}

impl Viewer {
    /// Somebody has connected. `limit`: bytes of frames a second.
    pub fn new(address: IpAddr, resume: String, limit: Option<f64>, now: f64) -> Self {
        Self {
            address,
            standing: Standing::Greeting,
            resume,
            heard: now,
            clock: PageClock::default(),
            rates: [240.0, 2000.0, 60.0, 10.0].map(|rate| Rate::new(rate, now)),
            set: 0,
            told: None,
            still: None,
            waits: false,
            fetches: false,
            served: f64::NEG_INFINITY,
            quality: Quality::default(),
            limit: limit.map(|limit| Rate::new(limit, now)),
            sent: VecDeque::new(),
            sees: None,
            report: None,
            values: None,
        }
    }

    /// How the newest picture, which has been the same since `since` and may be `exact`, is to be sent, and what it replaces.
    /// `None` while that is not to be.
    pub fn wants(
        &mut self,
        shown: &Shown,
        exact: bool,
        since: f64,
        now: f64,
    ) -> Option<(Coding, Option<Arc<Shown>>)> {
        let has_room = self.sent.len() < FRAMES && self.sent.iter().map(|s| s.bytes).sum::<usize>() < BYTES;
        if self.waits || !has_room || self.limit.as_mut().is_some_and(|limit| !limit.is_open(now)) {
            return None;
        }
        let (before, is_exact) = match &self.sees {
            Some((sees, is_exact)) => (Some(sees), *is_exact),
            None => (None, false),
        };
        if before.is_none_or(|before| before.number != shown.number) {
            let coding = Coding::Jpeg { quality: self.quality.jpeg, half: self.quality.half };
            return Some((coding, before.cloned()));
        }
        let is_still = exact && !shown.moving && now - since >= STILL;
        (is_still && !is_exact).then_some((Coding::Lossless, None))
    }

    /// A picture goes out, of so many bytes; of none where it is what it was.
    pub fn sends(&mut self, shown: &Arc<Shown>, coding: Coding, bytes: usize, now: f64) {
        let lossless = coding == Coding::Lossless;
        self.sees = Some((Arc::clone(shown), lossless && shown.exact));
        self.served = now;
        if bytes > 0 {
            self.sent.push_back(Sent { number: shown.number as u32, at: now, bytes, lossless });
            if let Some(limit) = &mut self.limit {
                limit.spend(bytes as f64, now);
            }
        }
    }

    /// A frame was drawn, and with it all before.
    pub fn drew(&mut self, number: u32, now: f64) {
        if !self.sent.iter().any(|sent| sent.number == number) {
            return;
        }
        while let Some(sent) = self.sent.pop_front() {
            // What is large by itself tells nothing of the others.
            if !sent.lossless {
                self.quality.drawn(now - sent.at, now);
            }
            if sent.number == number && self.sent.iter().all(|s| s.number != number) {
                break;
            }
        }
    }

    /// It is welcomed once more: the walk has begun anew.
    pub fn welcomed(&mut self) {
        (self.told, self.values, self.report) = (None, None, None);
    }

    /// Whether it is to hear this report now.
    pub fn hears(&mut self, report: &Arc<Report>, now: f64) -> bool {
        let is_new =
            self.report.as_ref().is_none_or(|(heard, at)| !Arc::ptr_eq(heard, report) && now - at >= REPORT);
        if is_new {
            self.report = Some((Arc::clone(report), now));
        }
        is_new
    }

    /// Whether these values are new to it.
    pub fn learns(&mut self, controls: &Controls) -> bool {
        self.values.replace(*controls) != Some(*controls)
    }

    /// Frames that were sent and not drawn yet.
    #[cfg(test)]
    pub fn on_the_way(&self) -> usize {
        self.sent.len()
    }
}

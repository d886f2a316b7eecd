//! One walk and those who look at it: who drives, and whether anybody looks.

use std::sync::Arc;

use foveal_engine::foveal::scene::Camera;
use foveal_engine::thread::{Report, Shown};

use crate::protocol::{Described, Role};
use crate::viewer::ViewerId;

/// Seconds without input after which whoever drives may be taken over from without being asked.
pub const IDLE_DRIVER: f64 = 10.0;
/// Seconds without viewers after which a walk pauses.
pub const PAUSE: f64 = 10.0;

/// A walk as its viewers share it.
#[derive(Debug, Default)]
pub struct Room {
    /// What pages are told of it; nothing until it stands.
    pub described: Option<Described>,
    /// What it shows.
    pub shown: Option<Arc<Shown>>,
    /// Since when it shows this picture.
    pub since: f64,
    /// Who drives.
    driver: Option<ViewerId>,
    /// By what the last driver is known, should the connection be lost.
    known: Option<String>,
    /// When it was last driven.
    driven: f64,
    /// Who has asked to drive.
    asked: Option<ViewerId>,
    /// Since when nobody looks.
    pub empty: Option<f64>,
    /// Whether it was told to pause.
    pub paused: bool,
    /// How often it was told that something is set.
    pub set: u64,
    /// Whether anybody has driven.
    pub walked: bool,
    /// Where it is to stand once it does.
    pub stands: Option<Camera>,
    /// The last report as a message.
    pub state: Option<(Arc<Report>, String)>,
}

/// What came of asking to drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// Who asked drives.
    Yes,
    /// Whoever drives was asked.
    Asked,
}

impl Room {
    /// A walk that nobody looks at; without a description it does not stand yet.
    pub fn new(described: Option<Described>, now: f64) -> Self {
        Self { described, since: now, empty: Some(now), ..Self::default() }
    }

    /// Whether what it shows is exact, with all that was set.
    pub fn is_exact(&self) -> bool {
        self.shown.as_ref().is_some_and(|shown| shown.exact && shown.set >= self.set)
    }

    /// Somebody comes who may drive, and does where nobody else is.
    pub fn enter(&mut self, id: ViewerId, resume: &str, now: f64) {
        if self.driver.is_none() {
            self.hand_to(id, resume, now);
        }
    }

    /// This one drives.
    pub fn hand_to(&mut self, id: ViewerId, resume: &str, now: f64) {
        self.driver = Some(id);
        self.known = Some(resume.to_owned());
        self.driven = now;
        self.asked = None;
    }

    /// Somebody leaves. Whether they drove.
    pub fn leave(&mut self, id: ViewerId) -> bool {
        self.asked = self.asked.filter(|asked| *asked != id);
        let drove = self.drives(id);
        if drove {
            self.driver = None;
        }
        drove
    }

    /// Whether whoever drove last is known by this.
    pub fn is_known(&self, known: Option<&str>) -> bool {
        self.known.is_some() && self.known.as_deref() == known
    }

    /// Whether it is this one who drives.
    pub fn drives(&self, id: ViewerId) -> bool {
        self.driver == Some(id)
    }

    /// The driver did something.
    pub fn is_driven(&mut self, now: f64) {
        self.walked = true;
        self.driven = now;
    }

    /// Somebody who may wants to drive.
    pub fn take(&mut self, id: ViewerId, resume: &str, now: f64) -> Taken {
        if self.drives(id) || self.driver.is_none() || now - self.driven >= IDLE_DRIVER {
            self.hand_to(id, resume, now);
            Taken::Yes
        } else {
            self.asked = Some(id);
            Taken::Asked
        }
    }

    /// Whoever drives agrees. To whom, where somebody had asked.
    pub fn give(&self, id: ViewerId) -> Option<ViewerId> {
        self.asked.filter(|_| self.drives(id))
    }

    /// What this one may do, and whether it is asked to let somebody else.
    pub fn role(&self, id: ViewerId) -> (Role, bool) {
        match self.drives(id) {
            true => (Role::Drives, self.asked.is_some()),
            false => (Role::Watches, false),
        }
    }
}

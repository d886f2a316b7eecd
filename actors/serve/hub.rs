//! All that happens between walks and viewers, as a state machine: events in, effects out, time is an argument.
//!
//! No socket, thread or clock in here, so a test can play any of them. Nothing that a viewer does can make it grow: viewers
//! and walks are counted, of pictures only the newest is known, and a viewer is sent the next one when it has drawn the
//! last but one.

mod driving;
mod entering;
mod pictures;

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::Arc;

use foveal_engine::thread::{Command, Shown};
use foveal_engine::walk::Notice;

pub use self::driving::SIDE_MAX;
use crate::coding::{Coded, Coding};
use crate::gate::{Gate, Token};
use crate::protocol::{self, Described, FromPage, Malformed, TEXT_MAX, Why, camera_from};
use crate::room::{PAUSE, Room};
use crate::viewer::{RoomId, Standing, Viewer, ViewerId};

/// Seconds that somebody has to say who they are.
const GREETING: f64 = 5.0;
/// Seconds after which somebody who says nothing is gone.
const IDLE: f64 = 600.0;

/// How walks are shared, and how many there may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Each who may drive has a walk, so many at most; else all share one.
    pub walks: Option<usize>,
    /// Viewers at once.
    pub viewers: usize,
    /// Bytes of frames a second to one viewer.
    pub bytes: Option<f64>,
    /// Seconds after which a walk of one's own ends when nobody looks at it.
    pub idle: f64,
}

/// What happened.
#[derive(Debug)]
pub enum Event {
    /// Somebody connected.
    Connected(ViewerId, IpAddr),
    /// Somebody said something.
    Text(ViewerId, String),
    /// Somebody did something.
    Input(ViewerId, Vec<u8>),
    /// Somebody is gone.
    Gone(ViewerId),
    /// A walk that was to be opened stands, or why not.
    Opened(RoomId, Result<Described, String>),
    /// A walk has begun anew.
    Described(RoomId, Described),
    /// A walk shows something new.
    Shown(RoomId, Arc<Shown>),
    /// A walk has something to say.
    Said(RoomId, Notice),
    /// A walk is over.
    Over(RoomId),
    /// A picture is coded.
    Coded(Order, Option<Coded>),
    /// A file for somebody is made.
    File(ViewerId, Vec<u8>),
    /// Time has passed.
    Tick,
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq)]
pub enum Effect {
    /// To be said to a viewer. What is `brief` may be left out where that one does not listen.
    Text(ViewerId, String, bool),
    /// To be sent to a viewer.
    Binary(ViewerId, Vec<u8>),
    /// A connection ends.
    Close(ViewerId, Why),
    /// A walk is told something; times are the server's.
    Tell(RoomId, Command),
    /// A picture is to be coded. One at a time.
    Code(Order),
    /// A walk begins.
    Open(RoomId),
    /// A walk ends.
    End(RoomId),
}

/// Why there is no picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Without {
    /// The token is wrong.
    Token,
    /// No walk shows anything.
    Picture,
}

/// A picture to be coded, and for whom.
#[derive(Clone, Debug)]
pub struct Order {
    /// The picture.
    pub shown: Arc<Shown>,
    /// What those see who get it.
    pub before: Option<Arc<Shown>>,
    /// How.
    pub coding: Coding,
    /// Who gets it.
    pub to: Vec<ViewerId>,
}

impl PartialEq for Order {
    fn eq(&self, other: &Self) -> bool {
        self.shown.number == other.shown.number && self.coding == other.coding && self.to == other.to
    }
}

/// The state of all of it.
#[derive(Debug)]
pub struct Hub {
    limits: Limits,
    gate: Gate,
    viewers: BTreeMap<ViewerId, Viewer>,
    rooms: BTreeMap<RoomId, Room>,
    next_room: RoomId,
    /// A picture is being coded.
    codes: bool,
    /// Viewers that were closed for what they sent.
    rude: u64,
    effects: Vec<Effect>,
}

impl Hub {
    /// Nobody there yet.
    pub fn new(limits: Limits, gate: Gate) -> Self {
        Self {
            limits,
            gate,
            viewers: BTreeMap::new(),
            rooms: BTreeMap::new(),
            next_room: 0,
            codes: false,
            rude: 0,
            effects: Vec::new(),
        }
    }

    /// A walk that all share.
    pub fn open(&mut self, described: Described, now: f64) -> RoomId {
        let id = self.next_room;
        self.next_room += 1;
        self.rooms.insert(id, Room::new(Some(described), now));
        id
    }

    /// Whether there is such a walk: while one was being opened, all who wanted it may have gone.
    pub fn has(&self, room: RoomId) -> bool {
        self.rooms.contains_key(&room)
    }

    /// Something happened at `now`, seconds. What is to be done then, in order.
    pub fn on(&mut self, event: Event, now: f64) -> Vec<Effect> {
        match event {
            Event::Connected(id, address) => self.on_connected(id, address, now),
            Event::Text(id, text) => self.on_text(id, &text, now),
            Event::Input(id, bytes) => self.on_input(id, &bytes, now),
            Event::Gone(id) => self.forget(id, now),
            Event::Opened(room, described) => self.on_opened(room, described, now),
            Event::Described(room, described) => self.on_described(room, described),
            Event::Shown(room, shown) => self.on_shown(room, shown, now),
            Event::Said(room, notice) => self.on_said(room, &notice),
            Event::Over(room) => self.on_over(room, now),
            Event::Coded(order, coded) => self.on_coded(&order, coded.as_ref(), now),
            Event::File(id, bytes) => self.on_file(id, &bytes),
            Event::Tick => self.on_tick(now),
        }
        self.spread(now);
        std::mem::take(&mut self.effects)
    }

    /// Everybody is told that it ends.
    pub fn shut(&mut self) -> Vec<Effect> {
        for id in self.viewers.keys() {
            self.effects.push(Effect::Text(*id, protocol::bye(Why::Shutdown), false));
            self.effects.push(Effect::Close(*id, Why::Shutdown));
        }
        self.viewers.clear();
        std::mem::take(&mut self.effects)
    }

    fn on_connected(&mut self, id: ViewerId, address: IpAddr, now: f64) {
        match Token::random() {
            Ok(resume) => {
                let viewer = Viewer::new(address, resume.as_str().to_owned(), self.limits.bytes, now);
                self.viewers.insert(id, viewer);
            }
            Err(e) => {
                tracing::error!("{e}");
                self.effects.push(Effect::Close(id, Why::Shutdown));
            }
        }
    }

    fn on_text(&mut self, id: ViewerId, text: &str, now: f64) {
        let Some(viewer) = self.viewers.get_mut(&id) else { return };
        viewer.heard = now;
        let message = if text.len() > TEXT_MAX { Err(Malformed) } else { FromPage::parse(text) };
        match (viewer.standing, message) {
            (_, Err(Malformed)) => self.dismiss(id, Why::Rude, now),
            (Standing::Greeting, Ok(FromPage::Hello { v, token, resume, camera })) => {
                self.on_hello(id, v, &token, resume.as_deref(), camera.and_then(camera_from), now);
            }
            (Standing::Greeting, Ok(_)) | (_, Ok(FromPage::Hello { .. })) => {
                self.dismiss(id, Why::Rude, now);
            }
            (Standing::In(..), Ok(FromPage::Shown { frame })) => viewer.drew(frame, now),
            (Standing::In(..), Ok(FromPage::Kept)) => viewer.fetches = false,
            (Standing::In(..), Ok(FromPage::Here)) => {}
            (Standing::In(room, _), Ok(FromPage::Set { key, value })) => {
                viewer.set += 1;
                if !viewer.rates[2].take(now) {
                    self.dismiss(id, Why::Rude, now);
                } else if self.is_driving(room, id, now) {
                    self.tell(room, Command::Put { key, value });
                }
            }
            (Standing::In(room, pass), Ok(FromPage::Do(deed))) => {
                viewer.set += u64::from(deed.sets());
                if viewer.rates[3].take(now) {
                    self.on_deed(id, room, pass, deed, now);
                } else {
                    self.dismiss(id, Why::Rude, now);
                }
            }
        }
    }

    /// Tells a walk something.
    fn tell(&mut self, room_id: RoomId, command: Command) {
        if let Some(room) = self.rooms.get_mut(&room_id) {
            room.set += u64::from(command.sets());
            self.effects.push(Effect::Tell(room_id, command));
        }
    }

    fn on_opened(&mut self, room_id: RoomId, described: Result<Described, String>, now: f64) {
        match described {
            Ok(described) => {
                if let Some(room) = self.rooms.get_mut(&room_id) {
                    room.described = Some(described);
                }
                for id in self.inside(room_id) {
                    self.welcome(id);
                }
                self.stand(room_id, now);
            }
            Err(why) => {
                self.on_said(room_id, &Notice { text: why, failed: true });
                self.on_over(room_id, now);
            }
        }
    }

    fn on_described(&mut self, room_id: RoomId, described: Described) {
        let Some(room) = self.rooms.get_mut(&room_id) else { return };
        room.described = Some(described);
        for id in self.inside(room_id) {
            self.welcome(id);
            self.viewers.get_mut(&id).into_iter().for_each(Viewer::welcomed);
        }
    }

    /// Who looks at a walk.
    fn inside(&self, room: RoomId) -> Vec<ViewerId> {
        let is_inside = |viewer: &Viewer| matches!(viewer.standing, Standing::In(r, _) if r == room);
        self.viewers.iter().filter(|(_, viewer)| is_inside(viewer)).map(|(id, _)| *id).collect()
    }

    fn on_shown(&mut self, room: RoomId, shown: Arc<Shown>, now: f64) {
        let Some(room) = self.rooms.get_mut(&room) else { return };
        if room.shown.as_ref().is_none_or(|before| before.number != shown.number) {
            room.since = now;
        }
        room.shown = Some(shown);
    }

    fn on_said(&mut self, room: RoomId, notice: &Notice) {
        let text = protocol::notice(&notice.text, notice.failed);
        let to = self.inside(room).into_iter();
        self.effects.extend(to.map(|id| Effect::Text(id, text.clone(), false)));
    }

    fn on_over(&mut self, room: RoomId, now: f64) {
        for id in self.inside(room) {
            self.dismiss(id, Why::Over, now);
        }
        if self.rooms.remove(&room).is_some() {
            self.effects.push(Effect::End(room));
        }
    }

    fn on_tick(&mut self, now: f64) {
        let patience = |viewer: &Viewer| match viewer.standing {
            Standing::Greeting => GREETING,
            Standing::In(..) => IDLE,
        };
        let silent = self.viewers.iter().filter(|(_, viewer)| now - viewer.heard > patience(viewer));
        for id in silent.map(|(id, _)| *id).collect::<Vec<_>>() {
            self.dismiss(id, Why::Idle, now);
        }
        let mut ended = Vec::new();
        for (id, room) in &mut self.rooms {
            let Some(empty) = room.empty else { continue };
            if !room.paused && now - empty >= PAUSE {
                room.paused = true;
                self.effects.push(Effect::Tell(*id, Command::Pause));
            }
            if self.limits.walks.is_some() && now - empty >= self.limits.idle {
                ended.push(*id);
            }
        }
        for id in ended {
            self.on_over(id, now);
        }
    }

    /// Somebody is told why, and gone.
    fn dismiss(&mut self, id: ViewerId, why: Why, now: f64) {
        if let (Why::Rude, Some(viewer)) = (why, self.viewers.get(&id)) {
            self.rude += 1;
            tracing::info!("{}: closed for what it sent, number {}", viewer.address, self.rude);
        }
        self.effects.push(Effect::Text(id, protocol::bye(why), false));
        self.effects.push(Effect::Close(id, why));
        self.forget(id, now);
    }

    fn forget(&mut self, id: ViewerId, now: f64) {
        let Some(Viewer { standing: Standing::In(room_id, _), .. }) = self.viewers.remove(&id) else {
            return;
        };
        let is_empty = self.inside(room_id).is_empty();
        let Some(room) = self.rooms.get_mut(&room_id) else { return };
        if is_empty {
            room.empty = Some(now);
        }
        if room.leave(id) {
            self.release(room_id, now);
        }
    }
}

#[cfg(test)]
#[path = "hub_tests.rs"]
mod tests;

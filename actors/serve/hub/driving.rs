//! Who drives, and what they do.

use foveal_engine::change::Change;
use foveal_engine::glam::Vec3;
use foveal_engine::thread::Command;
use foveal_engine::walk::Act;
use foveal_engine::{Lamp, SceneEdit};

use super::{Effect, Hub};
use crate::gate::Pass;
use crate::protocol::{self, Deed, INPUT_MAX, Malformed, Why, parse_input};
use crate::room::Taken;
use crate::viewer::{RoomId, Standing, ViewerId};

/// Least columns and rows of a picture.
const SIDE_MIN: u32 = 16;
/// Most columns and rows of a picture.
pub const SIDE_MAX: u32 = 4096;
/// Most by which a lamp is made brighter from a page.
const GAIN_MAX: f32 = 1e4;

impl Hub {
    /// Whether this one drives, who has just done something.
    pub(super) fn is_driving(&mut self, room: RoomId, id: ViewerId, now: f64) -> bool {
        let Some(room) = self.rooms.get_mut(&room).filter(|room| room.drives(id)) else { return false };
        room.is_driven(now);
        true
    }

    pub(super) fn on_deed(&mut self, id: ViewerId, room: RoomId, pass: Pass, deed: Deed, now: f64) {
        let act = match deed {
            Deed::Take => return self.on_take(id, room, pass, now),
            Deed::Give => {
                let given = self.rooms.get(&room).and_then(|room| room.give(id));
                return given.into_iter().for_each(|to| self.hand_over(room, to, now));
            }
            Deed::Screenshot => {
                let Some(viewer) = self.viewers.get_mut(&id) else { return };
                if std::mem::replace(&mut viewer.fetches, true) {
                    let text = protocol::notice("a picture is on its way already", true);
                    self.effects.push(Effect::Text(id, text, false));
                } else {
                    self.effects.push(Effect::Tell(room, Command::Shot { tag: id }));
                }
                return;
            }
            Deed::Size { .. } | Deed::Reload | Deed::Dim { .. } | Deed::Bring { .. } => {
                if self.is_driving(room, id, now) {
                    match self.change(room, deed) {
                        Some(change) => self.tell(room, Command::Change(change)),
                        None => {
                            let text = protocol::notice("that cannot be changed so", true);
                            self.effects.push(Effect::Text(id, text, false));
                        }
                    }
                }
                return;
            }
            Deed::Bookmark { number, set: true } => Act::SetBookmark(number.into()),
            Deed::Bookmark { number, set: false } => Act::GoTo(number.into()),
            Deed::Record => Act::ToggleRecording,
            Deed::Play => Act::TogglePlaying,
            Deed::Frame { .. } | Deed::Messages { .. } | Deed::Replay | Deed::Why { .. } | Deed::Branch => {
                if let Some(wish) = deed.wish().filter(|_| self.is_driving(room, id, now)) {
                    self.effects.push(Effect::Tell(room, Command::Wish(wish)));
                }
                return;
            }
        };
        if self.is_driving(room, id, now) {
            self.effects.push(Effect::Tell(room, Command::Act { act, at: now, mark: 0.0 }));
        }
    }

    /// What is to be changed of a walk, if it has that.
    fn change(&self, room: RoomId, deed: Deed) -> Option<Change> {
        let room = self.rooms.get(&room)?;
        let lamp = |number: u16| Some(room.described.as_ref()?.lamps.get(usize::from(number))?.lamp);
        Some(match deed {
            Deed::Size { width, height } => {
                let fits = [width, height].iter().all(|side| (SIDE_MIN..=SIDE_MAX).contains(side));
                fits.then_some(Change::Size([width, height]))?
            }
            Deed::Reload => Change::Reload,
            Deed::Dim { lamp: number, gain } => {
                let gain = (0.0..=GAIN_MAX).contains(&gain).then_some(Vec3::splat(gain))?;
                Change::Edit(SceneEdit::LampDimmed { lamp: lamp(number)?, gain })
            }
            Deed::Bring { lamp: number } => {
                let (Lamp::Light(light), Some(camera)) = (lamp(number)?, room.shown.as_ref()?.camera) else {
                    return None;
                };
                let direction = camera.target - camera.eye;
                Change::Edit(SceneEdit::LightMoved { light, position: camera.eye, direction })
            }
            _ => return None,
        })
    }

    pub(super) fn on_take(&mut self, id: ViewerId, room_id: RoomId, pass: Pass, now: f64) {
        let (Some(viewer), Some(room)) = (self.viewers.get(&id), self.rooms.get_mut(&room_id)) else {
            return;
        };
        if pass != Pass::Drive || room.drives(id) {
            return;
        }
        match room.take(id, &viewer.resume, now) {
            Taken::Yes => self.release(room_id, now),
            Taken::Asked => {
                let text = protocol::notice("whoever drives was asked", false);
                self.effects.push(Effect::Text(id, text, false));
            }
        }
    }

    pub(super) fn hand_over(&mut self, room_id: RoomId, to: ViewerId, now: f64) {
        if let (Some(viewer), Some(room)) = (self.viewers.get(&to), self.rooms.get_mut(&room_id)) {
            room.hand_to(to, &viewer.resume, now);
            self.release(room_id, now);
        }
    }

    /// Nobody holds a key any more.
    pub(super) fn release(&mut self, room: RoomId, now: f64) {
        let command = Command::Act { act: Act::ReleaseAll, at: now, mark: 0.0 };
        self.effects.push(Effect::Tell(room, command));
    }

    pub(super) fn on_input(&mut self, id: ViewerId, bytes: &[u8], now: f64) {
        let Some(viewer) = self.viewers.get_mut(&id) else { return };
        viewer.heard = now;
        let Standing::In(room, _) = viewer.standing else { return self.dismiss(id, Why::Rude, now) };
        let events = if bytes.len() > INPUT_MAX { Err(Malformed) } else { parse_input(bytes) };
        let Ok(events) = events else { return self.dismiss(id, Why::Rude, now) };
        let [messages, single, ..] = &mut viewer.rates;
        if !messages.take(now) || !events.iter().all(|_| single.take(now)) {
            return self.dismiss(id, Why::Rude, now);
        }
        if !self.is_driving(room, id, now) {
            return;
        }
        let Some(viewer) = self.viewers.get_mut(&id) else { return };
        if let Some(last) = events.last() {
            viewer.clock.heard(last.time / 1e3, now);
        }
        for event in events {
            let at = viewer.clock.time(event.time / 1e3, now);
            self.effects.push(Effect::Tell(room, Command::Act { act: event.act, at, mark: event.time }));
        }
    }
}

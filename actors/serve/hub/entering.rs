//! Who comes in, and what they are told first.

use std::net::IpAddr;
use std::sync::Arc;

use foveal_engine::foveal::scene::Camera;
use foveal_engine::thread::{Command, Shown};
use foveal_engine::walk::{Act, Notice};

use super::{Effect, Hub, Without};
use crate::gate::Pass;
use crate::protocol::{self, VERSION, Why};
use crate::room::Room;
use crate::viewer::{RoomId, Standing, Viewer, ViewerId};

impl Hub {
    pub(super) fn on_hello(
        &mut self,
        id: ViewerId,
        v: u32,
        token: &str,
        known: Option<&str>,
        camera: Option<Camera>,
        now: f64,
    ) {
        let Some(viewer) = self.viewers.get(&id) else { return };
        if v != VERSION {
            return self.dismiss(id, Why::Version, now);
        }
        let Some(pass) = self.gate.pass(viewer.address, token, now) else {
            tracing::warn!("{}: a wrong token", viewer.address);
            return self.dismiss(id, Why::Token, now);
        };
        // Who comes again by another connection is gone from the one before.
        let same = |other: &Viewer| known == Some(&*other.resume) && other.standing != Standing::Greeting;
        let again = self.viewers.iter().find(|(_, other)| same(other)).map(|(other, _)| *other);
        let again = again.and_then(|other| match self.viewers.get(&other)?.standing {
            Standing::In(room, _) => Some((other, room)),
            Standing::Greeting => None,
        });
        let mut back = self.rooms.iter().find(|(_, room)| room.is_known(known)).map(|(room, _)| *room);
        if let Some((other, room)) = again {
            back = Some(room);
            self.dismiss(other, Why::Elsewhere, now);
        }
        let inside = self.viewers.values().filter(|v| v.standing != Standing::Greeting).count();
        if inside >= self.limits.viewers {
            return self.dismiss(id, Why::Full, now);
        }
        let room = match (self.limits.walks, back) {
            (None, _) => self.rooms.keys().next().copied(),
            (Some(_), Some(room)) => Some(room),
            (Some(most), None) if self.rooms.len() < most => {
                let room = self.next_room;
                self.next_room += 1;
                self.rooms.insert(room, Room::new(None, now));
                self.effects.push(Effect::Open(room));
                Some(room)
            }
            (Some(_), None) => None,
        };
        let (Some(room_id), Some(viewer)) = (room, self.viewers.get_mut(&id)) else {
            return self.dismiss(id, Why::Full, now);
        };
        viewer.standing = Standing::In(room_id, pass);
        let resume = viewer.resume.clone();
        let Some(room) = self.rooms.get_mut(&room_id) else { return };
        room.empty = None;
        if pass == Pass::Drive {
            room.enter(id, &resume, now);
            if back.is_none() && room.drives(id) && !room.walked {
                // It was somewhere when a server ended that this one follows.
                room.stands = camera;
            }
        }
        if room.paused {
            room.paused = false;
            self.effects.push(Effect::Tell(room_id, Command::Resume));
        }
        self.welcome(id);
        self.stand(room_id, now);
    }

    /// What the first walk that shows anything does show, to somebody with this token, who stays outside.
    ///
    /// # Errors
    /// If the token is wrong, or there is nothing.
    pub fn still(&mut self, address: IpAddr, token: &str, now: f64) -> Result<Arc<Shown>, Without> {
        if self.gate.pass(address, token, now).is_none() {
            tracing::warn!("{address}: a wrong token");
            return Err(Without::Token);
        }
        self.rooms.values().find_map(|room| room.shown.clone()).ok_or(Without::Picture)
    }

    /// Goes to where a walk stood that another server served, once there is one.
    pub(super) fn stand(&mut self, room_id: RoomId, now: f64) {
        let Some(room) = self.rooms.get_mut(&room_id).filter(|room| room.described.is_some()) else { return };
        let Some(camera) = room.stands.take() else { return };
        room.walked = true;
        self.tell(room_id, Command::Act { act: Act::Stand(camera), at: now, mark: 0.0 });
        let text = "the server has begun anew; the walk stands where it was".to_owned();
        self.on_said(room_id, &Notice { text, failed: false });
    }

    /// Says what there is to know, once the walk stands.
    pub(super) fn welcome(&mut self, id: ViewerId) {
        let Some(viewer) = self.viewers.get_mut(&id) else { return };
        let Standing::In(room, pass) = viewer.standing else { return };
        let Some(room) = self.rooms.get(&room) else { return };
        if let Some(described) = &room.described {
            let (role, may_drive) = (room.role(id).0, pass == Pass::Drive);
            let text = protocol::welcome(id, &viewer.resume, role, may_drive, described);
            self.effects.push(Effect::Text(id, text, false));
        }
    }
}

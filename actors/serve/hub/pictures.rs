//! What viewers are sent: the newest, when they have drawn the last but one.

use std::collections::BTreeMap;
use std::sync::Arc;

use foveal_engine::thread::Shown;

use super::{Effect, Hub, Order};
use crate::coding::{Coded, Coding};
use crate::protocol::{self, FILE, Head};
use crate::report;
use crate::viewer::{RoomId, Standing, ViewerId};

impl Hub {
    pub(super) fn on_coded(&mut self, order: &Order, coded: Option<&Coded>, now: f64) {
        self.codes = false;
        let Order { shown, coding, to, .. } = order;
        for id in to {
            let Some(viewer) = self.viewers.get_mut(id) else { continue };
            let Standing::In(room, _) = viewer.standing else { continue };
            viewer.waits = false;
            let drives = self.rooms.get(&room).is_some_and(|room| room.drives(*id));
            let frame = coded.map(|coded| {
                let head = Head {
                    exact: shown.exact,
                    lossless: *coding == Coding::Lossless,
                    quality: if let Coding::Jpeg { quality, .. } = coding { *quality } else { 0 },
                    number: shown.number as u32,
                    view: shown.report.status.view,
                    size: [shown.picture.width(), shown.picture.height()].map(|side| side as u16),
                    mark: shown.mark.filter(|_| drives).unwrap_or(0.0),
                    took: shown.took,
                };
                head.with(coded)
            });
            viewer.sends(shown, *coding, frame.as_ref().map_or(0, Vec::len), now);
            self.effects.extend(frame.map(|frame| Effect::Binary(*id, frame)));
        }
    }

    pub(super) fn on_file(&mut self, id: ViewerId, bytes: &[u8]) {
        if self.viewers.contains_key(&id) {
            self.effects.push(Effect::Binary(id, [&[FILE], bytes].concat()));
        }
    }

    /// Tells viewers what is new, and has the next picture coded.
    pub(super) fn spread(&mut self, now: f64) {
        let mut order: Option<Order> = None;
        let mut by_age: Vec<ViewerId> = self.viewers.keys().copied().collect();
        by_age.sort_by(|a, b| self.viewers[a].served.total_cmp(&self.viewers[b].served));
        let counts: BTreeMap<RoomId, usize> =
            self.rooms.keys().map(|room| (*room, self.inside(*room).len())).collect();
        for id in by_age {
            let Some(viewer) = self.viewers.get_mut(&id) else { continue };
            let Standing::In(room_id, _) = viewer.standing else { continue };
            let Some(room) = self.rooms.get_mut(&room_id).filter(|room| room.described.is_some()) else {
                continue;
            };
            let (role, asked) = room.role(id);
            let told = (role, asked, counts.get(&room_id).copied().unwrap_or(0));
            if viewer.told.replace(told) != Some(told) {
                self.effects.push(Effect::Text(id, protocol::role(told.0, told.1, told.2), false));
            }
            let Some(shown) = &room.shown else { continue };
            if viewer.learns(&shown.report.controls) {
                self.effects.push(Effect::Text(id, protocol::values(&shown.report.controls), false));
            }
            if viewer.hears(&shown.report, now) {
                let is_same = room.state.as_ref().is_some_and(|(of, _)| Arc::ptr_eq(of, &shown.report));
                if !is_same {
                    let text = report::state(&shown.report, shown.camera.as_ref());
                    room.state = Some((Arc::clone(&shown.report), text));
                }
                self.effects.extend(room.state.iter().map(|(_, text)| Effect::Text(id, text.clone(), true)));
            }
            let exact = room.is_exact();
            let still = (shown.number, exact, viewer.set);
            if viewer.still.replace(still) != Some(still) {
                self.effects.push(Effect::Text(id, protocol::still(still.0, still.1, still.2), false));
            }
            if self.codes {
                continue;
            }
            let Some((coding, before)) = viewer.wants(shown, exact, room.since, now) else { continue };
            let number = |shown: &Option<Arc<Shown>>| shown.as_ref().map(|shown| shown.number);
            match &mut order {
                None => {
                    viewer.waits = true;
                    order = Some(Order { shown: Arc::clone(shown), before, coding, to: vec![id] });
                }
                Some(order)
                    if Arc::ptr_eq(&order.shown, shown)
                        && order.coding == coding
                        && number(&order.before) == number(&before) =>
                {
                    viewer.waits = true;
                    order.to.push(id);
                }
                Some(_) => {}
            }
        }
        if let Some(order) = order {
            self.codes = true;
            self.effects.push(Effect::Code(order));
        }
    }
}

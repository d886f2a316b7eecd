//! Gamepads: the left stick walks, the right one looks around, triggers go down and up.

use std::thread;
use std::time::{Duration, Instant};

use foveal_engine::walk::Act;
use gilrs::{Axis, Button, EventType, Gamepad, Gilrs};
use winit::event_loop::EventLoopProxy;

use super::sticks::Sticks;
use super::{App, Wake};

/// Time between two steps while a stick is pushed.
const STEP: Duration = Duration::from_millis(8);

/// What the pad wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Push {
    /// Sticks and triggers are held so for so long.
    Held(Sticks, Duration),
    /// Another overlay.
    NextOverlay,
    /// As a key does it.
    Act(Act),
}

impl Sticks {
    fn of(pad: &Gamepad<'_>) -> Self {
        let trigger = |button| pad.button_data(button).map_or(0.0, gilrs::ev::state::ButtonData::value);
        Self {
            left: [Axis::LeftStickX, Axis::LeftStickY].map(|axis| pad.value(axis)),
            right: [Axis::RightStickX, Axis::RightStickY].map(|axis| pad.value(axis)),
            up: trigger(Button::RightTrigger2) - trigger(Button::LeftTrigger2),
        }
    }
}

fn pressed(button: Button) -> Option<Push> {
    Some(match button {
        Button::North => Push::NextOverlay,
        Button::Start => Push::Act(Act::TogglePlaying),
        Button::Select => Push::Act(Act::ToggleOrbit),
        Button::LeftTrigger => Push::Act(Act::Wheel(-1.0)),
        Button::RightTrigger => Push::Act(Act::Wheel(1.0)),
        Button::DPadUp => Push::Act(Act::GoTo(0)),
        Button::DPadRight => Push::Act(Act::GoTo(1)),
        Button::DPadDown => Push::Act(Act::GoTo(2)),
        Button::DPadLeft => Push::Act(Act::GoTo(3)),
        _ => return None,
    })
}

/// Listens to all pads, in a thread that ends with the window. Where there is no way to them the walk goes on without.
pub fn listen(proxy: EventLoopProxy<Wake>) {
    let work = move || match Gilrs::new() {
        Ok(pads) => hear(pads, &proxy),
        Err(e) => tracing::info!("no gamepads: {e}"),
    };
    if let Err(e) = thread::Builder::new().name("gamepads".into()).spawn(work) {
        tracing::warn!("no gamepads: {e}");
    }
}

fn hear(mut pads: Gilrs, proxy: &EventLoopProxy<Wake>) {
    let (mut held, mut since) = (Sticks::default(), Instant::now());
    loop {
        // While all rest nothing is asked, and nobody woken.
        let event = pads.next_event_blocking((!held.rest()).then_some(STEP));
        let mut push = None;
        // A pad tells its sticks up to a thousand times a second.
        if !held.rest() && since.elapsed() >= STEP {
            push = Some(Push::Held(held, std::mem::replace(&mut since, Instant::now()).elapsed()));
        }
        let rested = held.rest();
        match event.map(|event| (event.id, event.event)) {
            Some((_, EventType::ButtonPressed(button, _))) => push = pressed(button).or(push),
            Some((_, EventType::Disconnected)) => held = Sticks::default(),
            Some((id, EventType::AxisChanged(..) | EventType::ButtonChanged(..))) => {
                held = Sticks::of(&pads.gamepad(id));
            }
            _ => {}
        }
        if rested {
            since = Instant::now();
        }
        // The window is closed.
        if push.is_some_and(|push| proxy.send_event(Wake::Pad(push)).is_err()) {
            return;
        }
    }
}

impl App {
    pub(super) fn on_pad(&mut self, push: Push) {
        let now = self.now();
        let Some(walk) = self.walk.as_mut().filter(|_| !self.hidden) else { return };
        match push {
            Push::Held(sticks, time) => {
                let ([aside, up, ahead], [right, down]) = sticks.motion();
                let time = time.as_secs_f32();
                let way = walk.navigator.speed() * time;
                if [right, down] != [0.0; 2] {
                    walk.act(Act::Look(right * time, down * time), now);
                }
                if [aside, up, ahead] != [0.0; 3] {
                    walk.stride(aside * way, up * way, ahead * way, now);
                }
            }
            Push::NextOverlay => {
                walk.next_overlay();
                self.picture_is_new = true;
            }
            Push::Act(act) => walk.act(act, now),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buttons_do_what_keys_do() {
        assert_eq!(pressed(Button::North), Some(Push::NextOverlay));
        assert_eq!(pressed(Button::RightTrigger), Some(Push::Act(Act::Wheel(1.0))));
        assert_eq!(pressed(Button::Mode), None);
    }
}

//! Keys, the mouse and fingers: what they do to the walk and to the window.

use winit::event::{ElementState, MouseButton, MouseScrollDelta, Touch, TouchPhase, WindowEvent};
use winit::event_loop::ActiveEventLoop;
use winit::keyboard::KeyCode;
use winit::window::{CursorGrabMode, Fullscreen};

use super::App;
use super::fingers::Drag;
use foveal_engine::navigation::Motion;
use foveal_engine::source::Wish;
use foveal_engine::walk::Act;

impl App {
    pub(super) fn wish(&mut self, wish: Wish) {
        let now = self.now();
        if let Some(walk) = &mut self.walk {
            walk.wish(wish, now);
            self.picture_is_new = true;
        }
        self.request_redraw();
    }

    /// The wish of a key, where a recording is shown.
    fn wish_of(&self, key: KeyCode) -> Option<Wish> {
        let (shown, _) = self.walk.as_ref()?.timeline()?;
        let (at, last) = (shown.frame.unwrap_or(0), shown.frames.saturating_sub(1));
        Some(match key {
            KeyCode::Space => Wish::Play,
            KeyCode::ArrowLeft => Wish::Frame(at.saturating_sub(1)),
            KeyCode::ArrowRight => Wish::Frame((at + 1).min(last)),
            KeyCode::Home => Wish::Frame(0),
            KeyCode::End => Wish::Frame(last),
            KeyCode::Comma => Wish::Messages(-1),
            KeyCode::Period => Wish::Messages(1),
            KeyCode::KeyB => Wish::Branch,
            _ => return None,
        })
    }

    /// The pixel of the picture under the pointer.
    fn pixel(&self) -> Option<[u32; 2]> {
        let rect = self.screen.as_ref()?.picture_rect;
        let [columns, rows] = self.walk.as_ref()?.size();
        let scale = f64::from(self.context.pixels_per_point());
        let at = |pointer: f64, from: f32, length: f32, count: u32| {
            let share = ((pointer / scale) as f32 - from) / length.max(1.0);
            (0.0..1.0).contains(&share).then_some((share * count as f32) as u32)
        };
        Some([
            at(self.pointer.0, rect.left(), rect.width(), columns)?,
            at(self.pointer.1, rect.top(), rect.height(), rows)?,
        ])
    }

    pub(super) fn on_key(
        &mut self,
        key: KeyCode,
        pressed: bool,
        repeated: bool,
        types: bool,
        event_loop: &ActiveEventLoop,
    ) {
        let now = self.now();
        let control = self.modifiers.control_key();
        if control && key == KeyCode::KeyQ && pressed {
            event_loop.exit();
            return;
        }
        match key {
            KeyCode::F1 if pressed && !repeated => self.help = !self.help,
            KeyCode::F5 if pressed && !repeated && self.loading.is_none() => self.load(None),
            KeyCode::F11 if pressed && !repeated => self.toggle_full_screen(),
            KeyCode::F12 if pressed && !repeated => self.screenshot(),
            KeyCode::Escape if pressed => self.look_around(false),
            // A key that went down before a value was typed must still go up.
            _ if types && pressed => {}
            _ if pressed && let Some(wish) = self.wish_of(key) => self.wish(wish),
            _ => self.on_walk_key(key, pressed, repeated, now),
        }
        self.request_redraw();
    }

    fn on_walk_key(&mut self, key: KeyCode, pressed: bool, repeated: bool, now: f64) {
        let control = self.modifiers.control_key();
        let Some(walk) = &mut self.walk else { return };
        if let Some(motion) = motion(key) {
            walk.act(if pressed { Act::Press(motion) } else { Act::Release(motion) }, now);
            return;
        }
        if !pressed || repeated {
            return;
        }
        match key {
            KeyCode::KeyO => walk.act(Act::ToggleOrbit, now),
            KeyCode::KeyR => walk.act(Act::ToggleRecording, now),
            KeyCode::KeyP => walk.act(Act::TogglePlaying, now),
            KeyCode::Tab => {
                walk.next_overlay();
                self.picture_is_new = true;
            }
            _ => match digit(key) {
                Some(bookmark) if control => walk.act(Act::SetBookmark(bookmark), now),
                Some(bookmark) => walk.act(Act::GoTo(bookmark), now),
                None => {}
            },
        }
    }

    fn toggle_full_screen(&self) {
        let Some(screen) = &self.screen else { return };
        let is_full = screen.window.fullscreen().is_some();
        screen.window.set_fullscreen((!is_full).then_some(Fullscreen::Borderless(None)));
    }

    /// Fingers on the picture steer the walk. Where one lies on the panel, that has it (egui makes a pointer of the first).
    fn on_touch(&mut self, touch: &Touch, now: f64) {
        let at = (touch.location.x, touch.location.y);
        match touch.phase {
            TouchPhase::Started => {
                self.pointer = at;
                if self.fingers.have_room() && self.pointer_on_picture() {
                    self.fingers.press(touch.id, at);
                }
            }
            TouchPhase::Moved => match (self.fingers.drag(touch.id, at), &mut self.walk) {
                (Some(Drag::Look([right, down])), Some(walk)) => {
                    walk.act(Act::Look(right as f32, down as f32), now);
                }
                (Some(Drag::Walk(way)), Some(walk)) => {
                    let width =
                        self.screen.as_ref().map_or(512.0, |s| f64::from(s.picture_rect.width().max(1.0)));
                    let pixels = f64::from(self.context.pixels_per_point()) * width;
                    let [aside, up, ahead] =
                        way.map(|way| (way / pixels * f64::from(walk.place().diagonal)) as f32);
                    walk.stride(aside, up, ahead, now);
                }
                _ => return,
            },
            TouchPhase::Ended | TouchPhase::Cancelled => self.fingers.release(touch.id),
        }
        self.request_redraw();
    }

    /// Begins or ends looking around with the mouse.
    pub(super) fn look_around(&mut self, begins: bool) {
        let Some(screen) = &self.screen else { return };
        self.looking = begins.then_some(self.pointer);
        let mode = if begins { CursorGrabMode::Confined } else { CursorGrabMode::None };
        // Some displays cannot confine the mouse; then it may leave the window.
        let _ = screen.window.set_cursor_grab(mode);
        if begins {
            let now = self.now();
            if let Some(walk) = &mut self.walk {
                walk.take_over(now);
            }
        }
    }

    /// Whether the pointer is over the picture and no part of the interface.
    fn pointer_on_picture(&self) -> bool {
        let Some(screen) = &self.screen else { return false };
        let scale = f64::from(self.context.pixels_per_point());
        let at = egui::pos2((self.pointer.0 / scale) as f32, (self.pointer.1 / scale) as f32);
        let over_window = self.context.layer_id_at(at).is_some_and(|l| l.order != egui::Order::Background);
        screen.picture_rect.contains(at) && !over_window
    }

    pub(super) fn on_pointer(&mut self, event: &WindowEvent) {
        let now = self.now();
        match event {
            WindowEvent::Touch(touch) => self.on_touch(touch, now),
            WindowEvent::CursorMoved { position, .. } => {
                self.pointer = (position.x, position.y);
                if let (Some(from), Some(walk)) = (self.looking.replace(self.pointer), &mut self.walk) {
                    let (dx, dy) = (position.x - from.0, position.y - from.1);
                    walk.act(Act::Look(dx as f32, dy as f32), now);
                } else {
                    self.looking = None;
                }
            }
            WindowEvent::MouseInput { state, button: MouseButton::Right, .. } => match state {
                ElementState::Pressed if self.pointer_on_picture() => self.look_around(true),
                ElementState::Pressed => {}
                ElementState::Released => self.look_around(false),
            },
            WindowEvent::MouseInput { state: ElementState::Pressed, button: MouseButton::Left, .. }
                if self.pointer_on_picture() =>
            {
                if let Some([x, y]) = self.pixel() {
                    self.wish(Wish::Why(x, y));
                }
            }
            WindowEvent::MouseWheel { delta, .. } if self.pointer_on_picture() => {
                let steps = match delta {
                    MouseScrollDelta::LineDelta(_, y) => *y,
                    MouseScrollDelta::PixelDelta(p) => p.y as f32 / 50.0,
                };
                if let Some(walk) = &mut self.walk {
                    walk.act(Act::Wheel(steps), now);
                }
            }
            _ => {}
        }
    }
}

fn motion(key: KeyCode) -> Option<Motion> {
    Some(match key {
        KeyCode::KeyW | KeyCode::ArrowUp => Motion::Forward,
        KeyCode::KeyS | KeyCode::ArrowDown => Motion::Backward,
        KeyCode::KeyA | KeyCode::ArrowLeft => Motion::Left,
        KeyCode::KeyD | KeyCode::ArrowRight => Motion::Right,
        KeyCode::KeyE | KeyCode::PageUp => Motion::Up,
        KeyCode::KeyQ | KeyCode::PageDown => Motion::Down,
        _ => return None,
    })
}

/// Number of a bookmark's key, counted from 0.
fn digit(key: KeyCode) -> Option<usize> {
    use KeyCode::{Digit1, Digit2, Digit3, Digit4, Digit5, Digit6, Digit7, Digit8, Digit9};
    [Digit1, Digit2, Digit3, Digit4, Digit5, Digit6, Digit7, Digit8, Digit9].iter().position(|k| *k == key)
}

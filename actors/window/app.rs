//! The event loop: the window's events become a walk's input, its pictures become the window's.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::keyboard::{KeyCode, ModifiersState, PhysicalKey};
use winit::window::{CursorGrabMode, Window, WindowId};

use super::interface::{self, Interface};
use super::navigation::{Motion, Pace};
use super::panel;
use super::presenter::{Backend, Painted, Presented, Presenter};
use super::probe::{Measured, Probe};
use super::screenshot;
use super::source::{Build, Loader};
use super::timeline::Wish;
use super::walk::{Next, Walk};

/// What a window is opened with.
pub struct Options {
    /// The scene's name, shown until its title is known.
    pub name: String,
    /// Columns and rows of the picture; the panel stands beside it.
    pub size: [u32; 2],
    /// Who paints.
    pub backend: Backend,
    /// Loads scenes.
    pub loader: Loader,
    /// Where screenshots go.
    pub screenshots: PathBuf,
    /// Who measures instead of a user, if anybody.
    pub probe: Option<Probe>,
}

/// Why a window could not be opened, or had to close.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WindowError {
    /// The machine lacks something: no display, a library is missing.
    Environment(String),
    /// The scene cannot be walked through.
    Scene(String),
}

/// What other threads tell the event loop.
#[derive(Clone, Copy, Debug)]
pub enum Wake {
    /// A scene was loaded, or not.
    Loaded,
}

/// Shows a window until it is closed.
///
/// # Errors
/// If there is no display, or the first scene cannot be loaded.
pub fn run(options: Options) -> Result<Measured, WindowError> {
    // A missing libxkbcommon-x11 makes winit's keyboard library panic.
    let opened = catch_unwind(AssertUnwindSafe(|| EventLoop::<Wake>::with_user_event().build()));
    let event_loop = match opened {
        Ok(Ok(event_loop)) => event_loop,
        Ok(Err(e)) => return Err(WindowError::Environment(no_display(&e.to_string()))),
        Err(_) => return Err(WindowError::Environment(no_display("a library of the display is missing"))),
    };
    let mut app = App::new(options, event_loop.create_proxy());
    event_loop.run_app(&mut app).map_err(|e| WindowError::Environment(no_display(&e.to_string())))?;
    match app.failure {
        Some(failure) => Err(failure),
        None => Ok(app.options.probe.map(|probe| probe.measured).unwrap_or_default()),
    }
}

fn no_display(reason: &str) -> String {
    format!(
        "no window can be opened: {reason}; set DISPLAY or WAYLAND_DISPLAY, install `libx11-6 libx11-xcb1 \
         libxcursor1 libxi6 libxkbcommon-x11-0` (Debian), or use --headless"
    )
}

/// A scene that is being loaded.
struct Loading {
    result: Receiver<Result<Build, String>>,
    /// The camera stays: the same scene again.
    stays: bool,
}

/// The window and what paints it.
struct Screen {
    window: Arc<Window>,
    presenter: Presenter,
    egui: egui_winit::State,
    picture: Option<egui::TextureHandle>,
    /// Where the picture is, points.
    picture_rect: egui::Rect,
    /// When the interface wants to be painted without input.
    repaint_at: Option<Instant>,
}

struct App {
    options: Options,
    proxy: EventLoopProxy<Wake>,
    start: Instant,
    context: egui::Context,
    screen: Option<Screen>,
    walk: Option<Walk>,
    loading: Option<Loading>,
    failure: Option<WindowError>,
    modifiers: ModifiersState,
    /// The mouse looks around since this position, pixels.
    looking: Option<(f64, f64)>,
    pointer: (f64, f64),
    help: bool,
    hidden: bool,
    /// The textures of the picture must be made anew.
    picture_is_new: bool,
}

impl App {
    fn new(options: Options, proxy: EventLoopProxy<Wake>) -> Self {
        Self {
            options,
            proxy,
            start: Instant::now(),
            context: egui::Context::default(),
            screen: None,
            walk: None,
            loading: None,
            failure: None,
            modifiers: ModifiersState::default(),
            looking: None,
            pointer: (0.0, 0.0),
            help: false,
            hidden: false,
            picture_is_new: false,
        }
    }

    fn now(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn load(&mut self, path: Option<PathBuf>) {
        let (sender, result) = channel();
        let (loader, proxy) = (self.options.loader.clone(), self.proxy.clone());
        self.loading = Some(Loading { result, stays: path.is_none() && self.walk.is_some() });
        let started = std::thread::Builder::new().name("loader".into()).spawn(move || {
            let loaded = catch_unwind(AssertUnwindSafe(|| loader(path.as_deref())))
                .unwrap_or_else(|_| Err("loading the scene failed unexpectedly".into()));
            let _ = sender.send(loaded);
            let _ = proxy.send_event(Wake::Loaded);
        });
        if let Err(e) = started {
            self.loading = None;
            self.on_load_failed(format!("no thread to load with: {e}"));
        }
    }

    fn on_loaded(&mut self) {
        let Some(loading) = &self.loading else { return };
        let Ok(result) = loading.result.try_recv() else { return };
        let stays = loading.stays;
        self.loading = None;
        match result.and_then(|build| build()) {
            Ok(source) => {
                let now = self.now();
                match &mut self.walk {
                    Some(walk) if stays => {
                        walk.replace_source(source);
                        walk.tell("the scene was read again".into());
                    }
                    walk => *walk = Some(Walk::new(source, now)),
                }
                if let (Some(walk), Some(screen)) = (&self.walk, &self.screen) {
                    screen.window.set_title(&format!("foveal - {}", walk.place().title));
                }
            }
            Err(e) => self.on_load_failed(e),
        }
    }

    /// The first scene is needed; a later one is not.
    fn on_load_failed(&mut self, error: String) {
        match &mut self.walk {
            Some(walk) => walk.complain(error),
            None => self.failure = Some(WindowError::Scene(error)),
        }
    }

    fn open_screen(&mut self, event_loop: &ActiveEventLoop) -> Result<Screen, WindowError> {
        let [width, height] = self.options.size;
        let size = winit::dpi::LogicalSize::new(
            f64::from(width) + f64::from(panel::WIDTH) + 20.0,
            f64::from(height),
        );
        let attributes = Window::default_attributes()
            .with_title(format!("foveal - {}", self.options.name))
            .with_inner_size(size);
        let failed = |e: String| WindowError::Environment(no_display(&e));
        let window = Arc::new(event_loop.create_window(attributes).map_err(|e| failed(e.to_string()))?);
        let display = event_loop.owned_display_handle();
        let presenter =
            Presenter::new(&window, display, self.options.backend).map_err(WindowError::Environment)?;
        let egui = egui_winit::State::new(
            self.context.clone(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            None,
            Some(presenter.texture_side_max()),
        );
        window.request_redraw();
        Ok(Screen {
            window,
            presenter,
            egui,
            picture: None,
            picture_rect: egui::Rect::NOTHING,
            repaint_at: None,
        })
    }

    /// The adapter or the surface is of no use any more: another one, and everything on it anew.
    fn reopen_presenter(&mut self, event_loop: &ActiveEventLoop) {
        let Some(screen) = &mut self.screen else { return };
        let display = event_loop.owned_display_handle();
        let made = Presenter::new(&screen.window, display.clone(), self.options.backend)
            .or_else(|_| Presenter::new(&screen.window, display, Backend::Cpu));
        match made {
            Ok(presenter) => {
                screen.presenter = presenter;
                // A new context sends its fonts again.
                self.context = egui::Context::default();
                screen.egui = egui_winit::State::new(
                    self.context.clone(),
                    egui::ViewportId::ROOT,
                    &screen.window,
                    Some(screen.window.scale_factor() as f32),
                    None,
                    Some(screen.presenter.texture_side_max()),
                );
                screen.picture = None;
                self.picture_is_new = true;
                screen.window.request_redraw();
            }
            Err(e) => {
                self.failure = Some(WindowError::Environment(e));
                event_loop.exit();
            }
        }
    }

    fn redraw(&mut self, event_loop: &ActiveEventLoop) {
        let (Some(screen), context) = (&mut self.screen, self.context.clone()) else { return };
        if self.picture_is_new
            && let Some(picture) = self.walk.as_ref().and_then(Walk::picture)
        {
            let before = screen.picture.take();
            screen.picture = Some(interface::texture(&context, before, picture));
            self.picture_is_new = false;
        }
        let input = screen.egui.take_egui_input(&screen.window);
        let presenter = screen
            .presenter
            .adapter()
            .map_or_else(|| "shown by the processor".to_owned(), |a| format!("shown by {a}"));
        let is_loading = self.loading.is_some() || screen.picture.is_none();
        let shown = Interface {
            walk: self.walk.as_ref(),
            picture: screen.picture.as_ref(),
            loading: is_loading.then_some(&*self.options.name),
            presenter: &presenter,
        };
        let (help, mut answer) = (&mut self.help, None);
        let output = context.run_ui(input, |ui| {
            answer = Some(interface::interface(ui, &shown, help));
        });
        let (controls, wished, picture_rect) =
            answer.map_or((None, None, egui::Rect::NOTHING), |a| (a.controls, a.wish, a.picture_rect));
        screen.picture_rect = picture_rect;
        if let (Some(walk), Some(controls)) = (&mut self.walk, controls) {
            let before = walk.controls().overlay;
            let tone = walk.controls().set.tone;
            walk.set_controls(controls);
            self.picture_is_new |= before != controls.overlay || tone != controls.set.tone;
        }
        screen.egui.handle_platform_output(&screen.window, output.platform_output);
        let delay = output.viewport_output.get(&egui::ViewportId::ROOT).map(|v| v.repaint_delay);
        screen.repaint_at = delay.and_then(|d| (d < Duration::from_secs(3600)).then(|| Instant::now() + d));
        let primitives = context.tessellate(output.shapes, output.pixels_per_point);
        let mut textures = output.textures_delta;
        let presented = screen.presenter.present(&Painted {
            primitives: &primitives,
            textures: &textures,
            pixels_per_point: output.pixels_per_point,
        });
        // egui wants to know that its textures were taken.
        textures.set.clear();
        textures.free.clear();
        match presented {
            Presented::Shown => {
                let now = self.start.elapsed().as_secs_f64();
                if let Some(probe) = &mut self.options.probe {
                    probe.on_presented(now, screen.picture.is_some());
                }
            }
            Presented::Again => screen.repaint_at = Some(Instant::now() + Duration::from_millis(50)),
            Presented::Lost => self.reopen_presenter(event_loop),
        }
        if let Some(wish) = wished {
            self.wish(wish);
        }
    }

    fn request_redraw(&self) {
        if let Some(screen) = &self.screen {
            screen.window.request_redraw();
        }
    }

    fn wish(&mut self, wish: Wish) {
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
        let picture = self.walk.as_ref()?.picture()?;
        let scale = f64::from(self.context.pixels_per_point());
        let at = |pointer: f64, from: f32, length: f32, count: usize| {
            let share = ((pointer / scale) as f32 - from) / length.max(1.0);
            (0.0..1.0).contains(&share).then_some((share * count as f32) as u32)
        };
        Some([
            at(self.pointer.0, rect.left(), rect.width(), picture.width())?,
            at(self.pointer.1, rect.top(), rect.height(), picture.height())?,
        ])
    }

    fn on_key(
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
            if pressed {
                walk.take_over(now);
                walk.navigator.press(motion, now);
            } else {
                walk.navigator.release(motion, now);
            }
            return;
        }
        if !pressed || repeated {
            return;
        }
        match key {
            KeyCode::KeyO => walk.navigator.set_orbits(!walk.navigator.orbits()),
            KeyCode::KeyR => walk.toggle_recording(now),
            KeyCode::KeyP => walk.toggle_playing(now),
            KeyCode::Tab => {
                walk.next_overlay();
                self.picture_is_new = true;
            }
            _ => match digit(key) {
                Some(bookmark) if control => walk.set_bookmark(bookmark, now),
                Some(bookmark) => walk.go_to(bookmark, now),
                None => {}
            },
        }
    }

    /// Begins or ends looking around with the mouse.
    fn look_around(&mut self, begins: bool) {
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

    fn screenshot(&mut self) {
        let Some(walk) = &mut self.walk else { return };
        let Some(picture) = walk.picture() else { return };
        let saved = screenshot::png(picture, &walk.facts())
            .and_then(|bytes| screenshot::save(&self.options.screenshots, &bytes));
        match saved {
            Ok(path) => walk.tell(format!("{} written", path.display())),
            Err(e) => walk.complain(e),
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

    fn on_pointer(&mut self, event: &WindowEvent) {
        let now = self.now();
        match event {
            WindowEvent::CursorMoved { position, .. } => {
                self.pointer = (position.x, position.y);
                if let (Some(from), Some(walk)) = (self.looking.replace(self.pointer), &mut self.walk) {
                    let (dx, dy) = (position.x - from.0, position.y - from.1);
                    walk.navigator.look(dx as f32, dy as f32, now);
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
                    walk.navigator.wheel(steps, now);
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

impl ApplicationHandler<Wake> for App {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.screen.is_some() {
            return;
        }
        let opened = catch_unwind(AssertUnwindSafe(|| self.open_screen(event_loop))).unwrap_or_else(|_| {
            Err(WindowError::Environment(no_display("a library of the display is missing")))
        });
        match opened {
            Ok(screen) => {
                self.screen = Some(screen);
                self.load(None);
            }
            Err(e) => {
                self.failure = Some(e);
                event_loop.exit();
            }
        }
    }

    fn user_event(&mut self, event_loop: &ActiveEventLoop, event: Wake) {
        match event {
            Wake::Loaded => self.on_loaded(),
        }
        if self.failure.is_some() {
            event_loop.exit();
        }
        self.request_redraw();
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(screen) = &mut self.screen else { return };
        // Keys steer the walk; the interface gets them while a value is typed. (Tab would go from slider to slider,
        // and each would keep the keys.)
        let types = self.context.egui_wants_keyboard_input();
        if types || !matches!(event, WindowEvent::KeyboardInput { .. }) {
            let response = screen.egui.on_window_event(&screen.window, &event);
            // egui answers a redraw with the wish for another one.
            if response.repaint && event != WindowEvent::RedrawRequested {
                screen.window.request_redraw();
            }
        }
        match &event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::RedrawRequested => self.redraw(event_loop),
            WindowEvent::Resized(size) => {
                self.hidden = size.width == 0 || size.height == 0;
                screen.presenter.resize([size.width, size.height]);
                screen.window.request_redraw();
            }
            WindowEvent::Occluded(hidden) => self.hidden = *hidden,
            WindowEvent::Focused(false) => {
                let now = self.now();
                if let Some(walk) = &mut self.walk {
                    walk.navigator.release_all(now);
                }
                self.look_around(false);
            }
            WindowEvent::ModifiersChanged(modifiers) => {
                self.modifiers = modifiers.state();
                let pace = match (self.modifiers.shift_key(), self.modifiers.control_key()) {
                    (true, false) => Pace::Fast,
                    (false, true) => Pace::Slow,
                    _ => Pace::Normal,
                };
                let now = self.now();
                if let Some(walk) = &mut self.walk {
                    walk.navigator.set_pace(pace, now);
                }
            }
            WindowEvent::KeyboardInput { event, .. } => {
                if let PhysicalKey::Code(key) = event.physical_key {
                    self.on_key(key, event.state.is_pressed(), event.repeat, types, event_loop);
                }
            }
            WindowEvent::DroppedFile(path) if self.loading.is_none() => self.load(Some(path.clone())),
            _ => self.on_pointer(&event),
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        let now = self.now();
        let mut next = Next::Input;
        if let (Some(walk), false) = (&mut self.walk, self.hidden) {
            let (is_new, then) = walk.tick(now);
            next = then;
            if let Some(probe) = &mut self.options.probe {
                match probe.tick(walk, next, now) {
                    Some(then) => next = then,
                    None => event_loop.exit(),
                }
            }
            if is_new {
                self.picture_is_new = true;
                self.request_redraw();
            }
        }
        let repaint_at = self.screen.as_ref().and_then(|s| s.repaint_at);
        if repaint_at.is_some_and(|t| t <= Instant::now()) {
            if let Some(screen) = &mut self.screen {
                screen.repaint_at = None;
            }
            self.request_redraw();
        }
        let at = |t: f64| self.start + Duration::from_secs_f64(t.max(0.0));
        event_loop.set_control_flow(match (next, repaint_at) {
            (Next::Now, _) => ControlFlow::Poll,
            (Next::At(t), Some(r)) => ControlFlow::WaitUntil(at(t).min(r)),
            (Next::At(t), None) => ControlFlow::WaitUntil(at(t)),
            (Next::Input, Some(r)) => ControlFlow::WaitUntil(r),
            (Next::Input, None) => ControlFlow::Wait,
        });
    }
}

//! The event loop: the window's events become a walk's input, its pictures become the window's.

mod fingers;
mod input;
#[cfg(feature = "gamepad")]
mod pad;
mod screen;
mod shots;
#[cfg(any(test, feature = "gamepad"))]
mod sticks;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::event::WindowEvent;
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::keyboard::{ModifiersState, PhysicalKey};
use winit::window::WindowId;

use self::fingers::Fingers;
use self::screen::Screen;
use self::shots::Asked;
use super::presenter::{Backend, DrawnBy};
use super::probe::{Measured, Probe};
use foveal_engine::Recipe;
use foveal_engine::change::{Change, Changer, apart};
use foveal_engine::navigation::Pace;
use foveal_engine::source::{Build, Loader};
use foveal_engine::walk::{Next, Walk};

/// What a window is opened with.
pub struct Options {
    /// The scene's name, shown until its title is known.
    pub name: String,
    /// Columns and rows of the picture, and of what is beneath it; the panel stands beside it.
    pub size: [u32; 2],
    /// Who paints.
    pub backend: Backend,
    /// Who draws the picture.
    pub drawn_by: DrawnBy,
    /// Seconds after which the adapter is lost, to see that the walk goes on.
    pub lose_adapter: Option<f64>,
    /// The same of the window's surface.
    pub lose_surface: Option<f64>,
    /// Loads scenes.
    pub loader: Loader,
    /// Begins a walk anew with pictures of another size, where the picture is to follow the window's.
    pub follows: Option<Changer>,
    /// Where screenshots go.
    pub screenshots: PathBuf,
    /// Who measures instead of a user, if anybody.
    pub probe: Option<Probe>,
}

impl Options {
    /// A window on the walks of a recipe; screenshots go where the program is.
    pub fn new(recipe: Recipe) -> Self {
        Self {
            name: recipe.scene.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            size: [recipe.settings.width, recipe.settings.height],
            ..Self::of(recipe.loader())
        }
    }

    /// The same, with a picture that follows the window's size.
    pub fn following(recipe: Recipe) -> Self {
        let (loader, changer) = recipe.clone().loader_and_changer();
        Self { loader, follows: Some(changer), ..Self::new(recipe) }
    }

    /// A window on whatever is loaded.
    pub fn of(loader: Loader) -> Self {
        Self {
            name: String::new(),
            size: [512, 512],
            backend: Backend::Auto,
            drawn_by: DrawnBy::Auto,
            lose_adapter: None,
            lose_surface: None,
            loader,
            follows: None,
            screenshots: ".".into(),
            probe: None,
        }
    }
}

/// Why a window could not be opened, or had to close.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WindowError {
    /// The machine lacks something: no display, a library is missing.
    Environment(String),
    /// The scene cannot be walked through.
    Scene(String),
    /// An actor panicked without which the walk cannot go on.
    Ended(String),
}

/// What other threads tell the event loop.
#[derive(Debug)]
pub enum Wake {
    /// A scene was loaded, or not.
    Loaded,
    /// A screen reader wants to know, or do, something.
    #[cfg(feature = "accesskit")]
    Access(egui_winit::accesskit_winit::Event),
    /// A gamepad is used.
    #[cfg(feature = "gamepad")]
    Pad(pad::Push),
}

#[cfg(feature = "accesskit")]
impl From<egui_winit::accesskit_winit::Event> for Wake {
    fn from(event: egui_winit::accesskit_winit::Event) -> Self {
        Self::Access(event)
    }
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
    #[cfg(feature = "gamepad")]
    pad::listen(event_loop.create_proxy());
    // The threads that all share are as important as this one, which waits for them: they are started by it.
    rayon::current_num_threads();
    // The scene is read while the window is opened.
    app.load(None);
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
    /// The camera stays, for it is the same scene: what to tell once it is there.
    stays: Option<String>,
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
    fingers: Fingers,
    help: bool,
    hidden: bool,
    /// The textures of the picture must be made anew.
    picture_is_new: bool,
    /// Screenshots on their way.
    asked: Vec<Asked>,
    /// When the window had another size last, if the picture does not know yet.
    resized: Option<f64>,
}

/// Seconds that a window's size rests before the picture follows it.
const RESTS: f64 = 0.3;
/// Most pixels of a picture that follows: larger ones are enlarged, because each costs time.
const PIXELS_MAX: f32 = 1280.0 * 800.0;
/// Fewest columns or rows.
const SIDE_MIN: f32 = 32.0;

/// The picture that fills so many columns and rows, or is enlarged to them.
fn size_within([width, height]: [f32; 2]) -> Option<[u32; 2]> {
    let scale = (PIXELS_MAX / (width * height)).sqrt().min(1.0);
    let side = |side: f32| (side * scale).floor();
    let sides = [side(width), side(height)];
    // Also where it is not a number.
    sides.iter().all(|side| *side >= SIDE_MIN).then(|| sides.map(|side| side as u32))
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
            fingers: Fingers::default(),
            help: false,
            hidden: false,
            picture_is_new: false,
            asked: Vec::new(),
            resized: None,
        }
    }

    fn now(&self) -> f64 {
        self.start.elapsed().as_secs_f64()
    }

    fn load(&mut self, path: Option<PathBuf>) {
        let loader = self.options.loader.clone();
        let stays = (path.is_none() && self.walk.is_some()).then(|| "the scene was read again".to_owned());
        self.load_by(stays, move || loader(path.as_deref()));
    }

    fn load_by(
        &mut self,
        stays: Option<String>,
        load: impl FnOnce() -> Result<Build, String> + Send + 'static,
    ) {
        let (sender, result) = channel();
        let proxy = self.proxy.clone();
        self.loading = Some(Loading { result, stays });
        let started = std::thread::Builder::new().name("loader".into()).spawn(move || {
            let _ = sender.send(apart(load));
            let _ = proxy.send_event(Wake::Loaded);
        });
        if let Err(e) = started {
            self.loading = None;
            self.on_load_failed(format!("no thread to load with: {e}"));
        }
    }

    /// Has the picture follow the window's size, once that has come to rest. Tells when to look again.
    fn follow(&mut self, now: f64) -> Option<f64> {
        let rests = self.resized? + RESTS;
        let is_shown = self.screen.as_ref().is_some_and(|screen| screen.shown.is_some());
        if now < rests || self.loading.is_some() || self.walk.is_some() && !is_shown {
            return Some(rests.max(now + 0.05));
        }
        self.resized = None;
        let (Some(changer), Some(walk), Some(screen)) = (&self.options.follows, &self.walk, &self.screen)
        else {
            return None;
        };
        let scale = screen.egui.egui_ctx().pixels_per_point();
        let wanted = size_within([screen.space.width() * scale, screen.space.height() * scale])?;
        let (size, opened) = (walk.size(), walk.opened()?);
        if wanted == size {
            return None;
        }
        let (changer, change) = (changer.clone(), Change::Size(wanted));
        self.load_by(Some(change.told()), move || changer(change, opened, size));
        None
    }

    fn on_loaded(&mut self) {
        let Some(loading) = &self.loading else { return };
        let Ok(result) = loading.result.try_recv() else { return };
        let stays = loading.stays.clone();
        self.loading = None;
        match result.and_then(|build| build()) {
            Ok(source) => {
                let now = self.now();
                match (&mut self.walk, stays) {
                    (Some(walk), Some(told)) => {
                        walk.replace_source(source);
                        walk.tell(told);
                    }
                    (Some(walk), None) => walk.move_to(source, now),
                    (None, _) => {
                        let walk = self.walk.insert(Walk::new(source, now));
                        walk.set_mirrored(self.screen.as_ref().is_some_and(|s| s.presenter.is_mirroring()));
                    }
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

    fn request_redraw(&self) {
        if let Some(screen) = &self.screen {
            screen.window.request_redraw();
        }
    }
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
            Ok(screen) => self.screen = Some(screen),
            Err(e) => {
                self.failure = Some(e);
                event_loop.exit();
            }
        }
    }

    fn user_event(&mut self, event_loop: &ActiveEventLoop, event: Wake) {
        match event {
            Wake::Loaded => self.on_loaded(),
            #[cfg(feature = "accesskit")]
            Wake::Access(event) => self.on_access(event.window_event),
            #[cfg(feature = "gamepad")]
            Wake::Pad(push) => self.on_pad(push),
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
                // The first size is the one that was asked for.
                let is_shown = screen.shown.is_some() && self.options.follows.is_some();
                self.resized = (is_shown && !self.hidden).then(|| self.now()).or(self.resized);
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
            if let Some(why) = walk.ended() {
                self.failure = Some(WindowError::Ended(why));
                event_loop.exit();
            }
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
        if let Some(screen) = self.screen.as_mut().filter(|s| s.shown.is_some()) {
            if self.options.lose_adapter.take_if(|t| *t <= now).is_some() {
                screen.presenter.lose();
                screen.window.request_redraw();
            }
            if self.options.lose_surface.take_if(|t| *t <= now).is_some() {
                screen.presenter.lose_surface();
                screen.window.request_redraw();
            }
        }
        if let Some(look) = self.follow(now).filter(|_| !self.hidden) {
            next = match next {
                Next::Now => next,
                Next::At(t) => Next::At(t.min(look)),
                Next::Input => Next::At(look),
            };
        }
        if self.collect_shots() {
            let soon = Next::At(now + 0.01);
            next = if next == Next::Input { soon } else { next };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_fills_its_window_up_to_a_number_of_pixels() {
        assert_eq!(size_within([640.0, 481.5]), Some([640, 481]));
        let [width, height] = size_within([3840.0, 2160.0]).expect("a picture");
        assert!(width * height <= 1280 * 800 && width * height > 1_000_000);
        assert!((width as f32 / height as f32 - 16.0 / 9.0).abs() < 0.01);
        for none in [[0.0, 500.0], [10.0, 500.0], [f32::NAN, 10.0], [-1.0, -1.0], [f32::INFINITY, 100.0]] {
            assert_eq!(size_within(none), None, "{none:?}");
        }
    }
}

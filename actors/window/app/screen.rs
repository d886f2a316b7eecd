//! The window itself: opening it, painting it, and making anew what was lost.

use std::sync::Arc;
use std::time::{Duration, Instant};

use winit::event_loop::ActiveEventLoop;
use winit::window::Window;

use super::{App, WindowError, no_display};
use crate::interface::{self, Interface};
use crate::panel;
use crate::presenter::{Backend, Painted, Presented, Presenter};
use foveal_engine::walk::Walk;

/// The window and what paints it.
pub(super) struct Screen {
    pub(super) window: Arc<Window>,
    pub(super) presenter: Presenter,
    pub(super) egui: egui_winit::State,
    /// The processor's picture.
    picture: Option<egui::TextureHandle>,
    /// What is on show, columns and rows.
    pub(super) shown: Option<(egui::TextureId, egui::Vec2)>,
    /// Where the picture is, points.
    pub(super) picture_rect: egui::Rect,
    /// The place for the picture, points.
    pub(super) space: egui::Rect,
    /// When the interface wants to be painted without input.
    pub(super) repaint_at: Option<Instant>,
}

impl App {
    pub(super) fn open_screen(&mut self, event_loop: &ActiveEventLoop) -> Result<Screen, WindowError> {
        let [width, height] = self.options.size;
        let wanted = [f64::from(width) + f64::from(panel::WIDTH) + 20.0, f64::from(height)];
        // No larger than the display: of a panel that is cut off nobody sees the rest.
        let monitor = event_loop.primary_monitor().or_else(|| event_loop.available_monitors().next());
        let most = monitor.map(|monitor| monitor.size().to_logical::<f64>(monitor.scale_factor()));
        let most = most.filter(|most| most.width > 0.0 && most.height > 0.0);
        let [width, height] = match most {
            Some(most) => [wanted[0].min(most.width), wanted[1].min(most.height)],
            None => wanted,
        };
        let size = winit::dpi::LogicalSize::new(width, height);
        let attributes = Window::default_attributes()
            .with_title(format!("foveal - {}", self.options.name))
            .with_inner_size(size)
            // Whoever reads it aloud must be there before it is seen.
            .with_visible(!cfg!(feature = "accesskit"));
        let failed = |e: String| WindowError::Environment(no_display(&e));
        let window = Arc::new(event_loop.create_window(attributes).map_err(|e| failed(e.to_string()))?);
        // Else the first size is the one that was asked for.
        if self.options.follows.is_some() && (window.scale_factor() != 1.0 || [width, height] != wanted) {
            self.resized = Some(self.now());
        }
        let display = event_loop.owned_display_handle();
        let presenter = Presenter::new(&window, display, self.options.backend, self.options.drawn_by)
            .map_err(WindowError::Environment)?;
        #[cfg_attr(not(feature = "accesskit"), expect(unused_mut, reason = "for screen readers alone"))]
        let mut egui = egui_winit::State::new(
            self.context.clone(),
            egui::ViewportId::ROOT,
            &window,
            Some(window.scale_factor() as f32),
            None,
            Some(presenter.texture_side_max()),
        );
        #[cfg(feature = "accesskit")]
        {
            egui.init_accesskit(event_loop, &window, self.proxy.clone());
            window.set_visible(true);
        }
        window.request_redraw();
        Ok(Screen {
            window,
            presenter,
            egui,
            picture: None,
            shown: None,
            picture_rect: egui::Rect::NOTHING,
            space: egui::Rect::NOTHING,
            repaint_at: None,
        })
    }

    /// The adapter or the surface is of no use any more: another one, and everything on it anew.
    fn reopen_presenter(&mut self, event_loop: &ActiveEventLoop) {
        let Some(screen) = &mut self.screen else { return };
        let display = event_loop.owned_display_handle();
        let drawn_by = self.options.drawn_by;
        let made = Presenter::new(&screen.window, display.clone(), self.options.backend, drawn_by)
            .or_else(|_| Presenter::new(&screen.window, display, Backend::Cpu, drawn_by));
        match made {
            Ok(presenter) => {
                tracing::warn!("the window is painted anew by {presenter}");
                screen.presenter = presenter;
                // A new context sends its fonts again.
                self.context = egui::Context::default();
                #[cfg(feature = "accesskit")]
                let reader = screen.egui.accesskit.take();
                screen.egui = egui_winit::State::new(
                    self.context.clone(),
                    egui::ViewportId::ROOT,
                    &screen.window,
                    Some(screen.window.scale_factor() as f32),
                    None,
                    Some(screen.presenter.texture_side_max()),
                );
                #[cfg(feature = "accesskit")]
                {
                    screen.egui.accesskit = reader;
                    self.context.enable_accesskit();
                }
                screen.picture = None;
                screen.shown = None;
                self.picture_is_new = true;
                screen.window.request_redraw();
                let mirrored = screen.presenter.is_mirroring();
                if let Some(walk) = &mut self.walk {
                    walk.set_mirrored(mirrored);
                }
                self.shots_were_lost();
            }
            Err(e) => {
                self.failure = Some(WindowError::Environment(e));
                event_loop.exit();
            }
        }
    }

    /// What a screen reader asks for.
    #[cfg(feature = "accesskit")]
    pub(super) fn on_access(&mut self, event: egui_winit::accesskit_winit::WindowEvent) {
        use egui_winit::accesskit_winit::WindowEvent;
        match event {
            WindowEvent::InitialTreeRequested => self.context.enable_accesskit(),
            WindowEvent::ActionRequested(request) => {
                if let Some(screen) = &mut self.screen {
                    screen.egui.on_accesskit_action_request(request);
                }
            }
            WindowEvent::AccessibilityDeactivated => self.context.disable_accesskit(),
        }
    }

    pub(super) fn redraw(&mut self, event_loop: &ActiveEventLoop) {
        let (Some(screen), context) = (&mut self.screen, self.context.clone()) else { return };
        let is_new = std::mem::take(&mut self.picture_is_new);
        if is_new && let Some(walk) = &mut self.walk {
            screen.show(walk, &context);
        }
        let input = screen.egui.take_egui_input(&screen.window);
        let presenter = screen.presenter.to_string();
        let is_loading = self.loading.is_some() || screen.shown.is_none();
        let shown = Interface {
            walk: self.walk.as_ref(),
            picture: screen.shown,
            loading: is_loading.then_some(&*self.options.name),
            presenter: &presenter,
        };
        let (help, mut answer) = (&mut self.help, None);
        let output = context.run_ui(input, |ui| {
            answer = Some(interface::interface(ui, &shown, help));
        });
        let (mut controls, mut wished) = (None, None);
        if let Some(answer) = answer {
            (screen.picture_rect, screen.space) = (answer.picture_rect, answer.space);
            (controls, wished) = (answer.controls, answer.wish);
        }
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
                // Once a window is to be seen there is time to compile, while the scene is loaded.
                screen.presenter.prepare();
                let now = self.start.elapsed().as_secs_f64();
                if let Some(probe) = &mut self.options.probe {
                    probe.on_presented(now, screen.shown.is_some(), is_new);
                }
            }
            Presented::Again => screen.repaint_at = Some(Instant::now() + Duration::from_millis(50)),
            Presented::Lost => self.reopen_presenter(event_loop),
        }
        if let Some(wish) = wished {
            self.wish(wish);
        }
    }
}

impl Screen {
    /// What the walk has drawn, on show from the next painting on.
    fn show(&mut self, walk: &mut Walk, context: &egui::Context) {
        if walk.is_mirrored()
            && let Some(mirror) = self.presenter.mirror()
        {
            if walk.draw_on(mirror) {
                self.shown = self
                    .presenter
                    .mirrored()
                    .map(|(id, [width, height])| (id, egui::vec2(width as f32, height as f32)));
                return;
            }
            tracing::warn!("the graphics adapter has no room for this scene; the processor draws it");
            self.presenter.end_mirroring();
            walk.set_mirrored(false);
        }
        if let Some(picture) = walk.picture() {
            let before = self.picture.take();
            let texture = interface::texture(context, before, picture);
            self.shown = Some((texture.id(), texture.size_vec2()));
            self.picture = Some(texture);
        }
    }
}

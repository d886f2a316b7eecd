//! What the panel and the timeline tell who cannot see them: every control has a name, and says what it does.

use std::sync::Arc;

use egui::accesskit::{Action, Node, Role};
use egui::{Context, RawInput, Rect, Ui};
use foveal::allocation::supersampling::RefinementProgress;
use foveal::splatting::supersampling::Supersampling;

use super::{panel, timeline};
use foveal_actors::insight::{Insight, MapRank};
use foveal_actors::renderer::overlay::Overlay;
use foveal_actors::settings::{Adjustment, Settings};
use foveal_actors::station::StationStatus;
use foveal_actors::textures::{Charge, TextureReport};
use foveal_engine::source::{
    ActorStatus, Controls, LaneSlice, LanesShown, Names, Ranges, Status, TimelineShown,
};
use foveal_engine::walk::{FrameTimes, Notice, Notices};

/// What a screen reader is told of what is drawn.
fn nodes(mut draw: impl FnMut(&mut Ui)) -> Vec<Node> {
    let context = Context::default();
    context.enable_accesskit();
    let area = Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(900.0, 4000.0));
    let mut told = None;
    // The second time everything knows its size.
    for time in 0..2 {
        let input = RawInput { screen_rect: Some(area), time: Some(f64::from(time)), ..RawInput::default() };
        let mut output = context.run_ui(input, &mut draw);
        told = output.platform_output.accesskit_update.take();
        output.drop_without_applying_deltas();
    }
    told.expect("egui tells it").nodes.into_iter().map(|(_, node)| node).collect()
}

/// Whether somebody can use it. (A scroll bar says by its role alone what it is.)
fn is_used(node: &Node) -> bool {
    let is_used = node.supports_action(Action::Click) || node.supports_action(Action::Focus);
    is_used && node.role() != Role::ScrollBar
}

/// Whether it has a name, by itself or by what stands beside it. (The name of a line of text is the text.)
fn is_named(node: &Node) -> bool {
    let name = if node.role() == Role::Label { node.value() } else { node.label() };
    name.is_some_and(|name| !name.trim().is_empty()) || !node.labelled_by().is_empty()
}

/// All that can be used has a name, and of these roles all say what they do.
fn check(nodes: &[Node], explained: &[Role]) {
    for node in nodes.iter().filter(|node| is_used(node)) {
        assert!(is_named(node), "without a name: {node:?}");
    }
    for node in nodes.iter().filter(|node| explained.contains(&node.role())) {
        assert!(node.description().is_some_and(|help| !help.is_empty()), "unexplained: {node:?}");
    }
}

fn of_role(nodes: &[Node], role: Role) -> impl Iterator<Item = &Node> {
    nodes.iter().filter(move |node| node.role() == role)
}

fn says(nodes: &[Node], text: &str) -> bool {
    // Words of their own are values; those of what can be used are labels.
    let holds = |words: Option<&str>| words.is_some_and(|words| words.contains(text));
    nodes.iter().any(|node| holds(node.value()) || holds(node.label()))
}

/// All of the panel, of a walk with everything that it may have to show.
fn panel_of(recorded: bool, lost_jobs: u32) -> Vec<Node> {
    let settings = Settings::new(64, 48, 4);
    let set = Adjustment {
        texture_bytes: Some(8 << 20),
        quality: Some(-1.0),
        refine: Some(Supersampling::default()),
        ..Adjustment::of(&settings, &Default::default())
    };
    let mut controls = Controls { set, overlay: Overlay::None };
    let station = StationStatus { guest: Some("north".into()), ..StationStatus::default() };
    let actor = ActorStatus {
        name: "tracer 1".into(),
        delivered: 7,
        waiting: 0,
        waiting_max: 2,
        busy: Default::default(),
    };
    let status =
        Status { converged: true, actors: vec![actor], stations: vec![station], ..Status::default() };
    let charge = Charge { pixels: 100.0, asked: Some(1), given: 3, loss: 5.0 };
    let unseen = Charge { asked: None, ..charge };
    let report = TextureReport {
        used: 1 << 20,
        held: 1 << 20,
        price_per_mib: 0.0,
        counts: [0; 2],
        bill: vec![charge, unseen],
    };
    let map = MapRank { object: 1, worth: 2.0, side: 0, wanted: 16, kept: false };
    let insight = Insight {
        maps: vec![map, MapRank { side: 16, worth: 1.0, ..map }],
        textures: Some((report, 2 << 20)),
        refinement: Some(RefinementProgress { tiles: 12, quiet: 3, error: Some(0.1), stated: Some(0.05) }),
        lost_jobs,
        ..Insight::default()
    };
    let names = Names {
        objects: vec!["rest".into(), "mirror ball".into()],
        textures: vec!["floor".into(), "wall".into()],
    };
    let mut notices = Notices::default();
    for n in 0..7 {
        notices.push(Notice { text: format!("tracer 1 panicked over job {n}"), failed: true });
    }
    let times = FrameTimes::default();
    nodes(|ui| {
        let shown = panel::Shown {
            status: &status,
            recorded,
            times: &times,
            quality: Some(-0.5),
            speed: 1.0,
            ranges: Ranges { workers: 4, textures: Some([1 << 20, 16 << 20]) },
            insight: Some((&insight, &names)),
            presenter: "shown by the processor",
            notices: &notices,
        };
        panel::panel(ui, &mut controls, &shown);
    })
}

#[test]
fn the_panel_names_and_explains_its_controls() {
    let explained =
        [Role::Slider, Role::CheckBox, Role::ComboBox, Role::Button, Role::DisclosureTriangle, Role::Meter];
    for recorded in [false, true] {
        let nodes = panel_of(recorded, 0);
        check(&nodes, &explained);
        for (role, least) in [(Role::Slider, 8), (Role::CheckBox, 3), (Role::ComboBox, 1), (Role::Meter, 4)] {
            assert!(of_role(&nodes, role).count() >= least, "{role:?}");
        }
        let buttons: Vec<&str> = of_role(&nodes, Role::Button).filter_map(Node::label).collect();
        assert!(Overlay::ALL.iter().all(|overlay| buttons.contains(&overlay.name())), "{buttons:?}");
        let bar = |name: &str| of_role(&nodes, Role::Meter).find(|bar| bar.label() == Some(name));
        let share = |name| bar(name).and_then(Node::numeric_value);
        assert!(share("floor, level 3").is_some_and(|share| (share - 0.7).abs() < 1e-6));
        assert_eq!(share("mirror ball, no room"), Some(1.0));
    }
}

#[test]
fn lost_jobs_and_the_last_messages_are_told() {
    for (lost, says_it) in [(0, false), (2, true)] {
        let nodes = panel_of(false, lost);
        assert_eq!(says(&nodes, "2 jobs lost"), says_it);
        assert!(says(&nodes, "job 6") && says(&nodes, "6 messages before") && !says(&nodes, "job 5"));
    }
    assert!(says(&panel_of(false, 1), "1 job lost"));
}

#[test]
fn the_timeline_names_and_explains_its_controls() {
    let slice = LaneSlice {
        lane: 0,
        start_ns: 0,
        duration_ns: 9,
        kind: "Order",
        at: "a:1".into(),
        is_critical: true,
    };
    let lanes = LanesShown { names: vec!["a".into()], whole_ns: 10, slices: vec![slice], arrows: Vec::new() };
    let shown = TimelineShown {
        frames: 10,
        frame: Some(3),
        actors: vec!["a".into(), "b".into()],
        state: ("a".into(), vec!["x = 1".into()]),
        found: vec![("frame 4".into(), "4".into())],
        lanes: Some(Arc::new(lanes)),
        parted: Some(5),
        ..TimelineShown::default()
    };
    let explained = [Role::Slider, Role::ComboBox, Role::Button, Role::TextInput];
    let bar = nodes(|ui| _ = timeline::timeline(ui, &shown, false));
    let state = nodes(|ui| _ = timeline::state(ui, &shown));
    for nodes in [&bar, &state] {
        check(nodes, &explained);
        assert_eq!(of_role(nodes, Role::ComboBox).count(), 1);
    }
    let canvas: Vec<&str> = of_role(&bar, Role::Canvas).filter_map(Node::label).collect();
    assert_eq!(canvas, ["deliveries in this frame: 1, to a"]);
}

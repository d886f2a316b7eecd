//! The panel's tables: the actors of the walk, and other machines that trace for it.

use egui::Ui;

use foveal_actors::station::StationStatus;
use foveal_engine::source::ActorStatus;

/// The heading of a column, and what stands in it.
type Column = (&'static str, &'static str);

const ACTORS: [Column; 4] = [
    ("actor", "Who does the work; actors share nothing and tell each other everything by messages"),
    ("delivered", "Messages, jobs and timers delivered to it so far"),
    ("queue / most", "Messages that wait for it now, and the most that ever waited"),
    ("busy, s", "Seconds it has worked so far"),
];

const STATIONS: [Column; 7] = [
    ("machine", "Another machine that traces for this walk"),
    ("cores", "Cores it traces with"),
    (
        "state",
        "proving: all of its first answers are checked; serving: it is trusted with more jobs; suspect: it does \
         not answer; other bits: its numbers are rounded differently from those of this machine",
    ),
    ("way, ms", "Time a message takes to it and back"),
    ("samples/s", "Samples it has sent per second"),
    ("late, shared", "Answers that came too late to be of use, and jobs that others were given as well"),
    ("checked", "Samples that were traced here as well, to check its answers"),
];

/// What each actor has done.
pub fn actors(ui: &mut Ui, actors: &[ActorStatus]) {
    let row = |actor: &ActorStatus| {
        [
            actor.name.clone(),
            actor.delivered.to_string(),
            format!("{} / {}", actor.waiting, actor.waiting_max),
            format!("{:.2}", actor.busy.as_secs_f32()),
        ]
    };
    table(ui, "actors", &ACTORS, actors.iter().map(row));
}

/// Machines that are there, and what they have done.
pub fn stations(ui: &mut Ui, stations: &[StationStatus]) {
    let row = |station: &StationStatus| {
        let counts = &station.counts;
        Some([
            station.guest.clone()?,
            station.cores.to_string(),
            station.told(),
            format!("{:.1}", station.round_trip * 1e3),
            format!("{:.0}", station.rate),
            format!("{}, {}", counts.late, counts.shared),
            counts.checked.to_string(),
        ])
    };
    table(ui, "stations", &STATIONS, stations.iter().filter_map(row));
}

/// Rows beneath headings; hovering over a cell says what stands in its column.
fn table<const N: usize>(
    ui: &mut Ui,
    id: &str,
    columns: &[Column; N],
    rows: impl Iterator<Item = [String; N]>,
) {
    egui::Grid::new(id).striped(true).num_columns(N).show(ui, |ui| {
        for (heading, help) in columns {
            ui.weak(*heading).on_hover_text(*help);
        }
        ui.end_row();
        for row in rows {
            for (cell, (_, help)) in row.into_iter().zip(columns) {
                ui.label(cell).on_hover_text(*help);
            }
            ui.end_row();
        }
    });
}

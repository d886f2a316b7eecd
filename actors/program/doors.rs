//! Doors of walks that follow each other in one window or browser, for other machines that trace.

use std::sync::Arc;

use crossbeam_queue::ArrayQueue;
use foveal_engine::recipe::{Beyond, Doors};
use foveal_remote::door::Door;
use foveal_remote::package::Package;

use super::tracers::TracersArguments;

/// What opens them, each at the address and with the key of the first.
pub fn doors(arguments: &TracersArguments) -> Option<Doors> {
    let (arguments, address) = (arguments.clone(), arguments.address()?.to_owned());
    let last: ArrayQueue<Door> = ArrayQueue::new(1);
    Some(Arc::new(move |opened, settings| {
        // Who traced for the last walk is told that it is over, and comes again.
        let before = last.pop().map(|door| door.invitation().clone());
        let door = match (Package::of(opened), before) {
            (Ok(package), None) => arguments.door(&address, package, settings)?,
            (Ok(package), Some(before)) => {
                let address = with_port_of(&address, &before.address);
                let letting = arguments.letting();
                Door::open(&address, before.key, package, settings.k_max, settings.stations, letting)?
            }
            (Err(e), None) => return Err(e),
            (Err(e), Some(_)) => {
                tracing::warn!("other machines trace no more: {e}");
                return Ok(None);
            }
        };
        let beyond = Beyond { outlets: door.outlets(), attach: Box::new(door.attacher()) };
        let _ = last.push(door);
        Ok(Some(beyond))
    }))
}

/// An address with the port that was found where it left the choice.
fn with_port_of(address: &str, found: &str) -> String {
    match (address.rsplit_once(':'), found.rsplit_once(':')) {
        (Some((host, _)), Some((_, port))) => format!("{host}:{port}"),
        _ => address.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::time::Duration;

    use clap::Parser;
    use foveal_engine::{Light, Settings, opened};
    use foveal_remote::key::Invitation;
    use foveal_remote::link;

    use super::*;

    #[test]
    fn the_next_walk_listens_where_the_first_did() {
        assert_eq!(with_port_of("quic/0.0.0.0:0", "quic/192.0.2.7:7447"), "quic/0.0.0.0:7447");
        assert_eq!(with_port_of("tcp/[::1]:0", "tcp/[::1]:9"), "tcp/[::1]:9");
    }

    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        tracers: TracersArguments,
    }

    /// Another size or an edit begins another walk: who had come to the first is sent away, and comes with the same key to the
    /// same place.
    #[test]
    fn a_walk_that_begins_anew_has_the_door_of_the_one_before() {
        let folder = tempfile::tempdir().expect("a folder");
        let key = folder.path().join("key");
        let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/box/box.toml");
        let light = Light { quick: true, baked: true, ..Light::default() };
        let opened = opened::open(&scene, &light, &()).expect("a scene");
        for link in ["tcp", "quic"] {
            let _ = std::fs::remove_file(&key);
            let address = format!("{link}/127.0.0.1:0");
            let words = ["walk", "--tracers", &address, "--tracers-key", key.to_str().expect("a name")];
            let line = Line::parse_from(words);
            let doors = doors(&line.tracers).expect("a door was asked for");
            let settings = line.tracers.settings(Settings::new(32, 24, 1));
            assert!(doors(&opened, &settings).expect("a door").is_some());
            let invitation: Invitation =
                std::fs::read_to_string(&key).expect("a key").parse().expect("an invitation");
            let mut first = link::connect(&invitation).expect("a door");
            assert!(doors(&opened, &settings).expect("the door again").is_some());
            let left = (0..500).any(|_| first.next(Duration::from_millis(10)).is_err());
            assert!(left, "{link}: the walk that is over keeps its guests");
            assert!(link::connect(&invitation).is_ok(), "{link}: the next one is somewhere else");
        }
    }
}

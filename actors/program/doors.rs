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
                Door::open(&address, before.key, package, settings.k_max, settings.stations)?
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
    use super::*;

    #[test]
    fn the_next_walk_listens_where_the_first_did() {
        assert_eq!(with_port_of("quic/0.0.0.0:0", "quic/192.0.2.7:7447"), "quic/0.0.0.0:7447");
        assert_eq!(with_port_of("tcp/[::1]:0", "tcp/[::1]:9"), "tcp/[::1]:9");
    }
}

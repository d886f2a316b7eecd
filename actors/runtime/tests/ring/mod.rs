//! Actors that pass tokens on to whom their state says: as sensitive to the order of deliveries as can be.

use foveal_runtime::*;

/// A token with the hops it has left and a value.
#[derive(serde::Serialize)]
pub struct Token {
    pub hops: u32,
    pub value: u64,
}

#[derive(Message)]
#[message(unsaved = "snapshots are tested where there is more to save")]
pub enum Msg {
    Meet(Vec<Address<Msg>>),
    Token(Token),
}

/// Flips one bit of what a player is about to take in, as a fault of memory would.
#[derive(Clone, Copy)]
pub struct Flip {
    pub actor: u32,
    pub at: u64,
    pub bit: u32,
}

pub struct Player {
    flip: Option<Flip>,
    others: Vec<Address<Msg>>,
    state: u64,
    received: u64,
}

impl Actor for Player {
    type Msg = Msg;
    const NAME: &'static str = "player";

    fn handle(&mut self, message: Msg, cx: &mut Cx<'_, Msg>) {
        match message {
            Msg::Meet(others) => self.others = others,
            Msg::Token(token) => {
                self.received += 1;
                let mut digest = Digest::new();
                digest.u64(self.state);
                digest.u64(token.value);
                self.state = digest.finish();
                let flip = self.flip.filter(|flip| flip.at + 1 == cx.index());
                if let Some(flip) = flip {
                    self.state ^= 1 << flip.bit;
                }
                if token.hops > 0 {
                    let to = self.others[(self.state >> 33) as usize % self.others.len()].clone();
                    let token = Token { hops: token.hops - 1, value: token.value ^ self.state };
                    cx.tell(&to, Msg::Token(token)).expect("there is room for every token");
                }
                if flip.is_some() {
                    // Long enough for another thread to meet the wrong token while this turn still runs.
                    std::thread::sleep(std::time::Duration::from_millis(2));
                }
            }
        }
    }

    fn digest(&self) -> Option<u64> {
        Some(self.state)
    }
}

/// Sends the tokens off.
struct Starter {
    players: Vec<Address<Msg>>,
    tokens: u64,
    hops: u32,
}

impl Actor for Starter {
    type Msg = Msg;
    const NAME: &'static str = "starter";

    fn started(&mut self, cx: &mut Cx<'_, Msg>) {
        for player in &self.players {
            cx.tell(player, Msg::Meet(self.players.clone())).expect("room");
        }
        for value in 0..self.tokens {
            let to = &self.players[value as usize % self.players.len()];
            cx.tell(to, Msg::Token(Token { hops: self.hops, value })).expect("room");
        }
    }

    fn handle(&mut self, _: Msg, _: &mut Cx<'_, Msg>) {}
}

/// `players` that pass `tokens` tokens on for `hops` hops each.
pub fn wire(wiring: &mut Wiring, players: usize, tokens: u64, hops: u32) -> Vec<Handle<Player>> {
    wire_flipped(wiring, players, tokens, hops, None)
}

/// The same with a fault in one of them.
pub fn wire_flipped(
    wiring: &mut Wiring,
    players: usize,
    tokens: u64,
    hops: u32,
    flip: Option<Flip>,
) -> Vec<Handle<Player>> {
    let declared: Vec<_> =
        (0..players).map(|_| wiring.declare::<Player>(Bounds::messages(tokens as usize + 1))).collect();
    let addresses: Vec<_> = declared.iter().map(Declared::address).collect();
    let starter = wiring.declare::<Starter>(Bounds::messages(1));
    wiring.spawn(starter, Starter { players: addresses, tokens, hops }, OnPanic::Resume);
    declared
        .into_iter()
        .map(|declared| {
            let flip = flip.filter(|flip| flip.actor == declared.address().id().0);
            wiring.spawn(
                declared,
                Player { flip, others: Vec::new(), state: 0, received: 0 },
                OnPanic::Resume,
            )
        })
        .collect()
}

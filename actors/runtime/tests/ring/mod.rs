//! Actors that pass tokens on to whom their state says: as sensitive to the order of deliveries as can be.

use foveal_runtime::*;

/// A token with the hops it has left and a value.
pub struct Token {
    pub hops: u32,
    pub value: u64,
}

pub enum Msg {
    Meet(Vec<Address<Msg>>),
    Token(Token),
}

impl Message for Msg {
    fn digest(&self, digest: &mut Digest) {
        match self {
            Self::Meet(others) => digest.u64(others.len() as u64),
            Self::Token(token) => {
                digest.u32(token.hops);
                digest.u64(token.value);
            }
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Meet(_) => "Meet",
            Self::Token(_) => "Token",
        }
    }
}

pub struct Player {
    others: Vec<Address<Msg>>,
    pub state: u64,
    pub received: u64,
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
                if token.hops > 0 {
                    let to = self.others[(self.state >> 33) as usize % self.others.len()].clone();
                    let token = Token { hops: token.hops - 1, value: token.value ^ self.state };
                    cx.tell(&to, Msg::Token(token)).expect("there is room for every token");
                }
            }
        }
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
    let declared: Vec<_> =
        (0..players).map(|_| wiring.declare::<Player>(Bounds::messages(tokens as usize + 1))).collect();
    let addresses: Vec<_> = declared.iter().map(Declared::address).collect();
    let starter = wiring.declare::<Starter>(Bounds::messages(1));
    wiring.spawn(starter, Starter { players: addresses, tokens, hops });
    declared
        .into_iter()
        .map(|declared| wiring.spawn(declared, Player { others: Vec::new(), state: 0, received: 0 }))
        .collect()
}

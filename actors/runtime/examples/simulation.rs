//! A race that a live run hardly shows: two tellers read a balance, add to it and write it back. A simulation finds a
//! schedule in which a payment is lost, says its seed, and shows that no schedule loses one where the account does the sum.
//!
//! `cargo run -p foveal-runtime --example simulation`

use foveal_runtime::simulate::{Schedule, Simulation, Strategy, exhaust};
use foveal_runtime::*;

#[derive(Message)]
#[message(unsaved = "an address is not read back from a snapshot")]
enum AccountMsg {
    Read { reply_to: Address<TellerMsg> },
    Write { balance: u64 },
    Add { amount: u64 },
}

struct Account {
    balance: u64,
}

impl Actor for Account {
    type Msg = AccountMsg;
    const NAME: &'static str = "account";

    fn handle(&mut self, message: AccountMsg, cx: &mut Cx<'_, AccountMsg>) {
        match message {
            AccountMsg::Read { reply_to } => {
                cx.tell(&reply_to, TellerMsg::Balance(self.balance)).expect("one answer for a question");
            }
            AccountMsg::Write { balance } => self.balance = balance,
            AccountMsg::Add { amount } => self.balance += amount,
        }
    }
}

#[derive(Message)]
enum TellerMsg {
    Balance(u64),
}

struct Teller {
    account: Address<AccountMsg>,
    amount: u64,
    careful: bool,
}

impl Actor for Teller {
    type Msg = TellerMsg;
    const NAME: &'static str = "teller";

    fn started(&mut self, cx: &mut Cx<'_, TellerMsg>) {
        let pays = match self.careful {
            true => AccountMsg::Add { amount: self.amount },
            false => AccountMsg::Read { reply_to: cx.address().clone() },
        };
        cx.tell(&self.account, pays).expect("room for both");
    }

    fn handle(&mut self, TellerMsg::Balance(before): TellerMsg, cx: &mut Cx<'_, TellerMsg>) {
        let balance = before + self.amount;
        cx.tell(&self.account, AccountMsg::Write { balance }).expect("room for both");
    }
}

fn wire(wiring: &mut Wiring, careful: bool) -> Handle<Account> {
    let account = wiring.declare::<Account>(Bounds::messages(4));
    for amount in [10, 20] {
        let teller = wiring.declare::<Teller>(Bounds::messages(1));
        wiring.spawn(teller, Teller { account: account.address(), amount, careful }, OnPanic::Stop);
    }
    wiring.spawn(account, Account { balance: 0 }, OnPanic::End)
}

/// The balance after one schedule, and what its seed was worth.
fn run(simulation: Simulation, careful: bool) -> (u64, Schedule) {
    let build = |wiring: &mut Wiring| wire(wiring, careful);
    let (mut runtime, account) = Runtime::build(Config::simulate(simulation), build).expect("no threads");
    runtime.pump(Limit::IDLE);
    let balance = runtime.inspect(account, |account| account.balance).expect("nothing runs any more");
    (balance, runtime.schedule())
}

fn main() {
    let lost = (0..1000).find(|seed| run(Simulation::new(*seed), false).0 != 30).expect("a race");
    println!("seed {lost} loses a payment: the balance is {}", run(Simulation::new(lost), false).0);
    let mut wrong = 0;
    let all = exhaust(1_000_000, |seed| {
        let strategy = Strategy::Exhaustive;
        let (balance, schedule) = run(Simulation { strategy, ..Simulation::new(seed) }, true);
        wrong += u64::from(balance != 30);
        schedule
    });
    assert!(all.complete && wrong == 0);
    println!("where the account adds, none of all {} schedules does", all.schedules);
}

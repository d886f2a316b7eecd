//! Stepping through a recording by commands.

use std::io::{BufRead, IsTerminal, Write};
use std::rc::Rc;

use foveal_engine::Failure;
use foveal_engine::interrupt::interrupted;
use foveal_engine::replay::when::Condition;
use foveal_engine::replay::{Source, Stepper, Telling};
use foveal_terminal::print::print_line;

const HELP: &str = "\
s [N]                 one delivery forward, or N
b [N]                 one back, or N
g FRAME|ACTOR:INDEX   go to where a frame was shown or a delivery made
f                     forward to the next shown frame
p                     position: number of deliveries made to each actor
n CONDITION           next place where a condition becomes true, as for --when
t ACTOR[.PATH]        print an actor's state
w X,Y                 why a pixel of the last shown frame looks as it does
q                     quit";

/// Runs the command.
pub fn run(
    source: Source,
    until: Option<&str>,
    back: Option<u32>,
    commands: bool,
    workers: usize,
    telling: Telling,
) -> Result<(), Failure> {
    let place = until.map(|text| source.place(text)).transpose()?;
    // Back from nowhere said is back from the end.
    let at_end = place.is_none() && back.is_some();
    let source = Rc::new(source);
    let mut session = Stepper::new(Rc::clone(&source), workers, telling)?;
    if place.is_some() || at_end {
        session.go(place)?;
    }
    if let Some(count) = back {
        session.back(u64::from(count))?;
    }
    print(&mut session);
    if commands { obey(&source, &mut session, telling) } else { Ok(()) }
}

/// Prints what was done.
fn print(session: &mut Stepper) {
    session.told().iter().for_each(|line| print_line(line));
}

fn why(session: &Stepper, text: &str) -> Result<(), Failure> {
    let pixel = super::pixel(text).map_err(Failure::Usage)?;
    session.why(pixel)?.0.iter().for_each(|line| print_line(line));
    Ok(())
}

/// Does what the lines of the standard input say.
fn obey(source: &Source, session: &mut Stepper, telling: Telling) -> Result<(), Failure> {
    let prompts = std::io::stdin().is_terminal();
    let mut lines = std::io::stdin().lock().lines();
    loop {
        if prompts {
            let _ = write!(std::io::stdout(), "{} › ", session.here());
            let _ = std::io::stdout().flush();
        }
        let Some(Ok(line)) = lines.next() else { return Ok(()) };
        if interrupted() {
            return Err(Failure::Interrupted("interrupted while stepping".into()));
        }
        let (command, rest) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
        let count = || match rest.trim() {
            "" => Ok(1),
            text => text.parse().map_err(|_| Failure::Usage(format!("`{text}` is no number of steps"))),
        };
        let done = match command {
            "" | "s" | "step" => count().and_then(|n| session.forward(n)),
            "b" | "back" => count().and_then(|n| session.back(n)),
            "g" | "go" => source.place(rest.trim()).and_then(|place| session.go(Some(place))),
            "f" | "frame" => session.next_frame(),
            "p" | "position" => {
                print_line(&session.positions());
                Ok(())
            }
            "n" | "next" => {
                let condition = Condition::parse(rest).map_err(Failure::Usage);
                condition.and_then(|condition| session.go_when(&condition))
            }
            "t" | "tell" => session.state(rest.trim()).map(|state| super::look::print_state(&state, telling)),
            "w" | "why" => why(session, rest.trim()),
            "q" | "quit" => return Ok(()),
            _ => {
                print_line(HELP);
                Ok(())
            }
        };
        print(session);
        match done {
            // A mistyped command is no end.
            Err(Failure::Usage(m)) => print_line(&m),
            other => other?,
        }
    }
}

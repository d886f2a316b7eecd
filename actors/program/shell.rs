//! `foveal completions` and `foveal man`: what a shell and a manual need, made from the arguments themselves.

use std::path::PathBuf;

use clap::{Args, CommandFactory};
use clap_complete::Shell;

use super::Cli;
use foveal_engine::failure::Failure;
use foveal_engine::files::{make_folder, write_atomic};
use foveal_terminal::print::print_line;

/// Arguments of `foveal completions`.
#[derive(Args, Debug)]
pub struct CompletionsArguments {
    /// Shell to complete for
    shell: Shell,
}

/// Arguments of `foveal man`.
#[derive(Args, Debug)]
pub struct ManArguments {
    /// Folder for the pages
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Prints the completions of a shell.
pub fn completions(a: &CompletionsArguments) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(a.shell, &mut Cli::command(), "foveal", &mut text);
    print_line(String::from_utf8_lossy(&text).trim_end());
    Ok(())
}

/// Writes a manual page for the program and each of its commands.
pub fn man(a: &ManArguments) -> Result<(), Failure> {
    make_folder(&a.out)?;
    let mut program = Cli::command();
    program.build();
    let mut open = vec![(String::from("foveal"), program)];
    while let Some((name, command)) = open.pop() {
        for below in command.get_subcommands().filter(|c| c.get_name() != "help") {
            open.push((format!("{name}-{}", below.get_name()), below.clone()));
        }
        let mut page = Vec::new();
        clap_mangen::Man::new(command)
            .title(name.to_uppercase())
            .render(&mut page)
            .map_err(|e| Failure::Environment(format!("a manual page cannot be made: {e}")))?;
        write_atomic(&a.out.join(format!("{name}.1")), &page)?;
    }
    Ok(())
}

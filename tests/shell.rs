//! Completions and manual pages name every command.

use std::fs;

use crate::support::{Foveal, folder};

#[test]
fn completions_and_manual_pages_name_the_commands() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let text = Foveal::new(&format!("completions {shell}")).ok().out;
        assert!(
            ["walk", "replay", "simulate", "until-converged"].iter().all(|w| text.contains(w)),
            "{shell}"
        );
    }
    Foveal::new("completions tcl").fails(2, &["tcl", "bash"]);
    let out = folder("man");
    Foveal::new("man --out").arg(&out).ok();
    for page in ["foveal", "foveal-walk", "foveal-log-check", "foveal-bench-stages"] {
        let text = fs::read_to_string(out.join(format!("{page}.1"))).expect(page);
        assert!(text.contains(".TH") && text.contains("SH OPTIONS"), "{page}");
    }
}

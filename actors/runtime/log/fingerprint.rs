//! Where a recording was made: everything that can change the bits of a result beside what is recorded.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::hint::black_box;

use crate::message::Digest;

/// What the bits of a run depend on beside its messages. Two runs with equal fingerprints compute alike; where they are
/// not equal they may, and a replay that diverges names what is different.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// Name and version of the program: [`crate::Config::program`].
    pub program: String,
    /// The compiler's version.
    pub compiler: String,
    /// What it compiled for.
    pub target: String,
    /// Instructions that code can choose at run time and that round differently, or are used in another order.
    pub processor: String,
    /// Hash of what the functions of the standard library (`sin`, `exp`, …) give: on most systems they are those of the
    /// system's library, and the last bit is its own.
    pub mathematics: u64,
    /// Version of this crate.
    pub runtime: String,
}

impl Fingerprint {
    /// The fingerprint of this process.
    pub fn here(program: &str) -> Self {
        Self {
            program: program.to_owned(),
            compiler: env!("FOVEAL_COMPILER").to_owned(),
            target: env!("FOVEAL_TARGET").to_owned(),
            processor: processor(),
            mathematics: mathematics(),
            runtime: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }

    /// What is different here, in one line; `None` if nothing is.
    pub fn difference(&self, here: &Self) -> Option<String> {
        let mathematics = |of: &Self| format!("{:016x}", of.mathematics);
        let differences: Vec<String> = [
            ("program", self.program.clone(), here.program.clone()),
            ("compiler", self.compiler.clone(), here.compiler.clone()),
            ("target", self.target.clone(), here.target.clone()),
            ("processor", self.processor.clone(), here.processor.clone()),
            ("mathematical functions", mathematics(self), mathematics(here)),
            ("runtime", self.runtime.clone(), here.runtime.clone()),
        ]
        .into_iter()
        .filter(|(_, there, here)| there != here)
        .map(|(what, there, here)| format!("{what} {there:?} there and {here:?} here"))
        .collect();
        (!differences.is_empty()).then(|| differences.join("; "))
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { program, compiler, target, processor, mathematics, runtime } = self;
        write!(f, "{program}, {compiler} for {target}, on {processor}, ")?;
        write!(f, "mathematical functions {mathematics:016x}, runtime {runtime}")
    }
}

/// The processor's extensions that matter.
fn processor() -> String {
    #[cfg(target_arch = "x86_64")]
    let found = [
        ("sse4.1", std::arch::is_x86_feature_detected!("sse4.1")),
        ("avx", std::arch::is_x86_feature_detected!("avx")),
        ("avx2", std::arch::is_x86_feature_detected!("avx2")),
        ("fma", std::arch::is_x86_feature_detected!("fma")),
        ("avx512f", std::arch::is_x86_feature_detected!("avx512f")),
    ];
    #[cfg(not(target_arch = "x86_64"))]
    let found = [(std::env::consts::ARCH, true)];
    found.into_iter().filter_map(|(name, there)| there.then_some(name)).collect::<Vec<_>>().join(" ")
}

/// What the functions give for arguments in and out of their easy range.
#[expect(clippy::disallowed_methods, reason = "what this system's functions give is the question")]
fn mathematics() -> u64 {
    let mut hash = Digest::new();
    for step in 1..=64_u32 {
        // Opaque, so that the compiler does not compute them with the functions of its own machine.
        let x = black_box(f64::from(step) * 0.737_373);
        let y = black_box(step as f32 * 0.737_373);
        for value in
            [x.sin(), x.cos(), x.tan(), x.exp(), x.ln(), x.powf(0.45), x.cbrt(), x.atan2(3.0), x.tanh()]
        {
            hash.f64(value);
        }
        for value in
            [y.sin(), y.cos(), y.tan(), y.exp(), y.ln(), y.powf(0.45), y.cbrt(), y.atan2(3.0), y.tanh()]
        {
            hash.f32(value);
        }
    }
    hash.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_named() {
        let here = Fingerprint::here("test 1.0");
        assert_eq!(here.difference(&Fingerprint::here("test 1.0")), None, "equal wherever it is asked");
        let there = Fingerprint { mathematics: 7, compiler: "rustc 1.0".into(), ..here.clone() };
        let line = there.difference(&here).expect("two differences");
        assert!(line.starts_with("compiler \"rustc 1.0\" there and \"rustc "), "{line}");
        assert!(line.contains("; mathematical functions \"0000000000000007\" there and"), "{line}");
        assert!(!line.contains('\n') && !line.contains("program"), "{line}");
    }
}

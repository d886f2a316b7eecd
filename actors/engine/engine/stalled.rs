//! Stopping actors where they are, to see that a walk goes on without them.

use foveal_runtime::Control;

use super::Engine;

/// Who stops where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stalled {
    /// Nobody.
    Nobody,
    /// All who trace rays.
    Tracers,
    /// Who keeps samples.
    CacheAger,
    /// Who looks at frames.
    Analyzer,
    /// Who orders jobs.
    Allocator,
    /// Who makes light better.
    Illuminator,
    /// All but the renderer.
    All,
}

impl Stalled {
    /// Each of them.
    pub const EACH: [Self; 7] = [
        Self::Nobody,
        Self::Tracers,
        Self::CacheAger,
        Self::Analyzer,
        Self::Allocator,
        Self::Illuminator,
        Self::All,
    ];

    /// As it is written on a command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Nobody => "nobody",
            Self::Tracers => "tracers",
            Self::CacheAger => "cache-ager",
            Self::Analyzer => "analyzer",
            Self::Allocator => "allocator",
            Self::Illuminator => "illuminator",
            Self::All => "all",
        }
    }
}

impl Engine {
    /// Somebody stops where it is, to see that the walk goes on.
    pub fn stall(&self, who: Stalled) {
        let (Some(runtime), actors) = (&self.runtime, &self.actors) else { return };
        let is = |one: Stalled| who == one || who == Stalled::All;
        for tracer in actors.tracers.iter().filter(|_| is(Stalled::Tracers)) {
            runtime.control(*tracer, Control::Pause);
        }
        if let Some(others) = &actors.correction {
            if is(Stalled::CacheAger) {
                runtime.control(others.cache_ager, Control::Pause);
            }
            if is(Stalled::Analyzer) {
                runtime.control(others.analyzer, Control::Pause);
            }
            if is(Stalled::Allocator) {
                runtime.control(others.allocator, Control::Pause);
            }
        }
        if let Some(illuminator) = actors.illuminator.filter(|_| is(Stalled::Illuminator)) {
            runtime.control(illuminator, Control::Pause);
        }
    }
}

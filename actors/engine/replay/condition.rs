//! Conditions on messages, on the state of actors and on pixels, as they are written and what they hold for.

use bytesize::ByteSize;
use foveal_runtime::Content;

/// How conditions are written, for messages and help.
pub const GRAMMAR: &str = "`ACTOR.PATH < 3`, `ACTOR.PATH changes`, `ACTOR hears MESSAGE [PATH > 3]`, \
                           `pixel X,Y changes` or `object \"NAME\" loses samples`";

/// How two values are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Comparison {
    Less,
    AtMost,
    Equal,
    Different,
    AtLeast,
    More,
}

/// What a value is compared with.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Bound {
    Number(f64),
    Name(String),
}

/// A comparison with what stands at a path.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Test {
    pub(super) path: String,
    pub(super) comparison: Comparison,
    bound: Bound,
}

/// Something that may come about.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    pub(super) of: Of,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Of {
    /// An actor's state comes to hold it.
    State(String, Test),
    /// Something in an actor's state becomes another.
    Changes(String, String),
    /// An actor is told a message.
    Hears(String, String, Option<Test>),
    /// A pixel of the shown picture becomes another.
    Pixel(u32, u32),
    /// The cache holds fewer samples of an object than before.
    Loses(String),
}

impl Comparison {
    fn holds(self, order: Option<std::cmp::Ordering>) -> bool {
        let Some(order) = order else { return self == Self::Different };
        match self {
            Self::Less => order.is_lt(),
            Self::AtMost => order.is_le(),
            Self::Equal => order.is_eq(),
            Self::Different => order.is_ne(),
            Self::AtLeast => order.is_ge(),
            Self::More => order.is_gt(),
        }
    }
}

impl Test {
    /// `PATH OP VALUE`.
    fn parse(text: &str) -> Option<Self> {
        let at = text.find(['<', '>', '=', '!'])?;
        let (path, rest) = text.split_at(at);
        let (comparison, bound) = [
            ("<=", Comparison::AtMost),
            (">=", Comparison::AtLeast),
            ("==", Comparison::Equal),
            ("!=", Comparison::Different),
            ("<", Comparison::Less),
            (">", Comparison::More),
            ("=", Comparison::Equal),
        ]
        .into_iter()
        .find_map(|(sign, comparison)| Some((comparison, rest.strip_prefix(sign)?.trim())))?;
        if path.trim().is_empty() || bound.is_empty() {
            return None;
        }
        let bound = match (bound.parse::<f64>(), bound.parse::<ByteSize>()) {
            (Ok(number), _) => Bound::Number(number),
            (_, Ok(size)) => Bound::Number(size.as_u64() as f64),
            _ => Bound::Name(bound.trim_matches('"').to_owned()),
        };
        Some(Self { path: path.trim().to_owned(), comparison, bound })
    }

    /// Whether it holds for what stands there; where nothing does, nothing holds.
    pub(super) fn holds(&self, value: &Content) -> bool {
        match (&self.bound, value) {
            (Bound::Number(bound), value) => {
                value.number().is_some_and(|number| self.comparison.holds(number.partial_cmp(bound)))
            }
            (Bound::Name(bound), Content::Name(name)) => {
                self.comparison.holds(Some(name.as_ref().cmp(bound)))
            }
            (Bound::Name(bound), Content::Text(text)) => self.comparison.holds(Some(text.cmp(bound))),
            (Bound::Name(bound), Content::Flag(flag)) => {
                self.comparison.holds(Some(flag.to_string().cmp(bound)))
            }
            _ => false,
        }
    }
}

/// `ACTOR.PATH`, where the actor's name may have blanks: paths have none.
fn of_actor(text: &str) -> Option<(String, String)> {
    let (actor, path) = text.trim().split_once('.')?;
    (!actor.is_empty() && !path.is_empty()).then(|| (actor.trim().to_owned(), path.trim().to_owned()))
}

impl Condition {
    /// Reads one.
    ///
    /// # Errors
    /// Says how conditions are written.
    pub fn parse(text: &str) -> Result<Self, String> {
        Self::read(text.trim()).map(|of| Self { of }).ok_or_else(|| {
            format!("`{text}` is no condition; write one as {GRAMMAR}; --state shows what can stand there")
        })
    }

    fn read(text: &str) -> Option<Of> {
        if let Some(rest) = text.strip_prefix("pixel ") {
            let (x, y) = rest.strip_suffix("changes")?.trim().split_once(',')?;
            return Some(Of::Pixel(x.trim().parse().ok()?, y.trim().parse().ok()?));
        }
        if let Some(rest) = text.strip_prefix("object ") {
            let name = rest.strip_suffix("samples")?.trim_end().strip_suffix("loses")?.trim();
            return Some(Of::Loses(name.trim_matches('"').to_owned()));
        }
        if let Some((actor, what)) = text.split_once(" hears ") {
            let (kind, test) = what.trim().split_once(' ').unwrap_or((what.trim(), ""));
            let test = if test.trim().is_empty() { None } else { Some(Test::parse(test)?) };
            return Some(Of::Hears(actor.trim().to_owned(), kind.to_owned(), test));
        }
        if let Some(place) = text.strip_suffix(" changes") {
            let (actor, path) = of_actor(place)?;
            return Some(Of::Changes(actor, path));
        }
        let test = Test::parse(text)?;
        let (actor, path) = of_actor(&test.path)?;
        Some(Of::State(actor, Test { path, ..test }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_read() {
        for text in [
            "renderer.view < 3",
            "allocator.budget.textures<1MiB",
            "cache ager.samples changes",
            "renderer hears SamplesTraced",
            "allocator hears JobDone samples >= 10",
            "pixel 3, 4 changes",
            "object \"Mirror ball\" loses samples",
            "allocator.converged = true",
        ] {
            assert!(Condition::parse(text).is_ok(), "{text}");
        }
        let limit = Condition::parse("allocator.budget.textures < 1MiB").expect("a condition");
        let Of::State(actor, Test { path, comparison, bound }) = limit.of else { panic!("a state") };
        assert_eq!(
            (actor.as_str(), path.as_str(), comparison),
            ("allocator", "budget.textures", Comparison::Less)
        );
        assert_eq!(bound, Bound::Number(1_048_576.0));
        for text in
            ["", "renderer", "renderer.view", "< 3", "renderer. < 3", "pixel 3 changes", "a hears b < "]
        {
            assert!(Condition::parse(text).is_err(), "{text}");
        }
    }
}

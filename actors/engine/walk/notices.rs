//! What the user was told last.

use std::collections::VecDeque;

/// A line for the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Notice {
    /// What happened.
    pub text: String,
    /// Whether it went wrong.
    pub failed: bool,
}

/// The last lines for the user, and how many came before them.
#[derive(Clone, Debug, Default)]
pub struct Notices {
    kept: VecDeque<Notice>,
    earlier: usize,
}

impl Notices {
    /// Lines that are kept.
    pub const KEPT: usize = 5;

    /// Something happened. What is said again at once is kept once.
    pub fn push(&mut self, notice: Notice) {
        if self.newest() == Some(&notice) {
            return;
        }
        if self.kept.len() == Self::KEPT {
            self.kept.pop_front();
            self.earlier += 1;
        }
        self.kept.push_back(notice);
    }

    /// The last of them.
    pub fn newest(&self) -> Option<&Notice> {
        self.kept.back()
    }

    /// Those that are kept, the newest first.
    pub fn iter(&self) -> impl Iterator<Item = &Notice> {
        self.kept.iter().rev()
    }

    /// How many are kept no more.
    pub fn earlier(&self) -> usize {
        self.earlier
    }

    /// Takes all that are kept, the oldest first.
    pub fn take(&mut self) -> impl Iterator<Item = Notice> + use<> {
        std::mem::take(self).kept.into_iter()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_lines_are_kept_and_the_others_counted() {
        let notice = |n: usize| Notice { text: n.to_string(), failed: false };
        let mut notices = Notices::default();
        assert_eq!((notices.newest(), notices.iter().count(), notices.earlier()), (None, 0, 0));
        for n in 0..Notices::KEPT + 2 {
            notices.push(notice(n));
            notices.push(notice(n));
        }
        assert_eq!(notices.newest(), Some(&notice(Notices::KEPT + 1)));
        assert_eq!(notices.earlier(), 2, "what is said again at once is one line");
        let texts: Vec<&str> = notices.iter().map(|n| &*n.text).collect();
        assert_eq!(texts, ["6", "5", "4", "3", "2"]);
        let taken: Vec<Notice> = notices.take().collect();
        assert_eq!((taken.first(), taken.len()), (Some(&notice(2)), Notices::KEPT));
        assert_eq!((notices.newest(), notices.earlier()), (None, 0));
    }
}

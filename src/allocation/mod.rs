//! Decision theory: actions, costs, qualities and budgets.

pub mod jobs;

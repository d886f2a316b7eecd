//! Decision theory: actions, costs, qualities and budgets.

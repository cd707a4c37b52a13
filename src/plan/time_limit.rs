//! The time limit of a search.

use std::cell::Cell;
use std::time::Duration;

/// Ends a search before a subproblem that would likely exceed the time limit. If the limit is above
/// 0, the first subproblem always runs: without it there is no plan.
#[derive(Debug)]
pub struct TimeLimit {
    limit: Duration,
    before: Cell<Duration>,
    longest: Cell<Duration>,
}

impl TimeLimit {
    /// A limit in s. A value that no duration can hold means no limit.
    pub fn new(limit_s: f64) -> Self {
        let limit = Duration::try_from_secs_f64(limit_s).unwrap_or(Duration::MAX);
        Self { limit, before: Cell::default(), longest: Cell::default() }
    }

    /// Whether the search must end before its next subproblem, which starts `passed` after the
    /// search did. Call it before each subproblem.
    pub fn is_over(&self, passed: Duration) -> bool {
        self.longest.set(self.longest.get().max(passed.saturating_sub(self.before.get())));
        self.before.set(passed);
        passed.saturating_add(self.longest.get()) > self.limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_subproblem_starts_that_would_end_late() {
        let limit = TimeLimit::new(8.0);
        let asked = [0.0, 3.0, 5.0, 5.1].map(|s| limit.is_over(Duration::from_secs_f64(s)));
        assert_eq!(asked, [false, false, false, true]);
        let first = Duration::from_millis(1);
        assert!(TimeLimit::new(0.0).is_over(first));
        assert!(!TimeLimit::new(f64::INFINITY).is_over(first));
    }
}

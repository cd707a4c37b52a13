//! The rates of an exam with their targets.

use super::{Bound, Measure};
use crate::exam::grade::Grade;
use crate::exam::interval::Rate;
use crate::exam::order::Kind;
use crate::exam::score::{Law, Row};

/// The scored cases of an exam, by the kind of question.
#[derive(Clone, Copy)]
pub(super) struct Cases<'a>(pub &'a [Row]);

impl<'a> Cases<'a> {
    /// The cases of one kind.
    fn of(self, kind: Kind) -> impl Iterator<Item = &'a Row> {
        self.0.iter().filter(move |row| row.kind == kind)
    }

    /// The cases with one effect.
    pub fn singles(self) -> impl Iterator<Item = &'a Row> {
        self.of(Kind::Single).chain(self.of(Kind::Modelled)).chain(self.of(Kind::RoundTrip))
    }

    /// The cases with one effect of practical size.
    fn practical_singles(self) -> impl Iterator<Item = &'a Row> {
        self.singles().filter(is_practical)
    }

    /// The cases of practical size whose causes the catalogue has and the flights show.
    pub fn known(self) -> impl Iterator<Item = &'a Row> {
        let is_known = |row: &&Row| !matches!(row.kind, Kind::LeftOut | Kind::Trap);
        self.0.iter().filter(is_known).filter(is_practical)
    }
}

fn is_practical(row: &&Row) -> bool {
    row.is_practical
}

/// Every rate with its target.
pub(super) fn measures(cases: Cases<'_>) -> Vec<Measure> {
    let intervals =
        || cases.known().flat_map(|row| row.covered.values().flatten().copied()).collect();
    let measure =
        |name, outcomes: Vec<bool>, wanted| Measure { name, rate: Rate::of(outcomes), wanted };
    let at_least = |bound| Some(Bound::AtLeast(bound));
    let at_most = |bound| Some(Bound::AtMost(bound));
    vec![
        measure(
            "verdict right",
            cases
                .0
                .iter()
                .filter(|row| row.is_practical || row.kind == Kind::Null)
                .map(Row::verdict_right)
                .collect(),
            at_least(0.9),
        ),
        measure(
            "named first, singles of practical size",
            cases.practical_singles().map(|r| r.top_right).collect(),
            at_least(0.95),
        ),
        measure(
            "truth in the named or ambiguous set",
            cases.practical_singles().map(|r| r.in_set).collect(),
            at_least(0.99),
        ),
        measure(
            "named without ambiguity",
            cases.practical_singles().map(|r| r.is_definite).collect(),
            at_least(0.8),
        ),
        measure(
            "confidently wrong, practical singles",
            cases.practical_singles().map(|r| r.confidently_wrong.is_some()).collect(),
            at_most(0.02),
        ),
        measure(
            "confidently wrong, everything",
            cases.0.iter().map(|r| r.confidently_wrong.is_some()).collect(),
            at_most(0.02),
        ),
        measure(
            "right or acceptable, below practical size",
            cases
                .0
                .iter()
                .filter(|r| matches!(r.law, Law::Catalogue | Law::Other) && !r.is_practical)
                .filter(|r| !r.kind.is_trap())
                .map(|r| r.grade.is_good())
                .collect(),
            None,
        ),
        measure(
            "top-1, wrong values in the file",
            cases.of(Kind::Modelled).filter(is_practical).map(|r| r.top_right).collect(),
            None,
        ),
        measure(
            "pairs, both named",
            cases.of(Kind::Pair).filter(is_practical).map(|r| r.all_named).collect(),
            at_least(0.8),
        ),
        measure(
            "pairs, exactly both",
            cases.of(Kind::Pair).filter(is_practical).map(|r| r.exact).collect(),
            None,
        ),
        measure(
            "false alarms on nulls",
            cases.of(Kind::Null).map(|r| !r.grade.is_good()).collect(),
            at_most(0.01),
        ),
        measure(
            "nulls that name only errors of the file",
            cases.of(Kind::Null).map(|r| r.grade == Grade::Acceptable).collect(),
            None,
        ),
        measure(
            "left out: unknown or ambiguous",
            cases.of(Kind::LeftOut).filter(is_practical).map(Row::admits_ignorance).collect(),
            at_least(0.85),
        ),
        measure(
            "left out: unknown",
            cases.of(Kind::LeftOut).filter(is_practical).map(|r| r.verdict == "unknown").collect(),
            None,
        ),
        measure(
            "out of the catalogue: unknown",
            cases.of(Kind::Foreign).filter(is_practical).map(|r| r.verdict == "unknown").collect(),
            at_least(0.9),
        ),
        measure(
            "top-1, other laws",
            cases.of(Kind::OtherLaw).filter(is_practical).map(|r| r.top_right).collect(),
            at_least(0.9),
        ),
        measure(
            "traps: ambiguous or not testable",
            cases.of(Kind::Trap).map(|r| r.trap_right).collect(),
            at_least(0.95),
        ),
        measure(
            "confidently wrong, traps",
            cases.of(Kind::Trap).map(|r| r.confidently_wrong.is_some()).collect(),
            at_most(0.03),
        ),
        measure("90 % intervals that hold, at least", intervals(), at_least(0.85)),
        measure("90 % intervals that hold, at most", intervals(), at_most(0.95)),
        measure(
            "no answer",
            cases.0.iter().map(|r| r.verdict == "missing").collect(),
            at_most(0.0),
        ),
    ]
}

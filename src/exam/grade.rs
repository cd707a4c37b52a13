//! Grades an answer against the key in one word.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::key::KeyEntry;
use super::order::Kind;

/// The grade of an answer.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// The right answer. Below the practical size, also `none`.
    Right,
    /// True and nothing false: a real deviation of the file with the right value, one effect of a
    /// pair, or the truth after a deviation or among at most two ambiguous effects.
    Acceptable,
    /// The truth, and something false.
    Mixed,
    /// Neither the truth nor anything false.
    Missed,
    /// Something false.
    Wrong,
}

impl Grade {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Acceptable => "acceptable",
            Self::Mixed => "mixed",
            Self::Missed => "missed",
            Self::Wrong => "wrong",
        }
    }

    /// Whether the answer is right or acceptable.
    pub fn is_good(self) -> bool {
        matches!(self, Self::Right | Self::Acceptable)
    }
}

/// The parts of an answer that its grade depends on.
pub(super) struct Stated<'a> {
    pub key: &'a KeyEntry,
    pub verdict: &'a str,
    pub trap_right: bool,
    /// Number of true effects that are named, and number of true effects.
    pub found: usize,
    pub expected: usize,
    /// Whether the first named effect is true.
    pub first: bool,
    /// Whether a named effect is false, and whether one is a real deviation.
    pub is_false: bool,
    pub is_deviation: bool,
    /// Whether the truth is among the ambiguous effects.
    pub admits: bool,
}

pub(super) fn grade(stated: &Stated<'_>) -> Grade {
    let Stated { key, verdict, found, expected, is_false, admits, .. } = *stated;
    let failed = if is_false { Grade::Wrong } else { Grade::Missed };
    match key.kind {
        Kind::Null => match verdict {
            "none" => Grade::Right,
            "effect" if stated.is_deviation && !is_false => Grade::Acceptable,
            "missing" => Grade::Missed,
            _ => Grade::Wrong,
        },
        Kind::LeftOut | Kind::Foreign => match verdict {
            "unknown" => Grade::Right,
            "none" if !key.is_practical => Grade::Right,
            _ if admits => Grade::Acceptable,
            _ => failed,
        },
        Kind::Trap if stated.trap_right => Grade::Right,
        Kind::Trap => failed,
        _ if found > 0 && is_false => Grade::Mixed,
        _ if found >= expected.max(1)
            || expected > 0 && found > 0 && key.kind == Kind::OtherLaw =>
        {
            if stated.first || expected > 1 { Grade::Right } else { Grade::Acceptable }
        }
        _ if found > 0 || admits => Grade::Acceptable,
        _ if !key.is_practical && verdict == "none" => Grade::Right,
        _ if !key.is_practical && stated.is_deviation && !is_false => Grade::Acceptable,
        _ => failed,
    }
}

//! How an answer stands to the key, in a word.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::key::KeyEntry;
use super::order::Kind;

/// How an answer stands to the key.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Grade {
    /// What it is to say. Of a size below the practical one, also `none`.
    Right,
    /// Something that is true, and nothing that is not: a deviation of the file that is really there
    /// with its value right, one effect of a pair, the truth after a deviation or among at most two
    /// that cannot be told apart.
    Acceptable,
    /// The truth, and something that is not.
    Mixed,
    /// Nothing of the truth, and nothing that is not true.
    Missed,
    /// Something that is not true.
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

    /// Whether nothing is held against the answer.
    pub fn is_good(self) -> bool {
        matches!(self, Self::Right | Self::Acceptable)
    }
}

/// What an answer says, as far as its grade goes.
pub(super) struct Stated<'a> {
    pub key: &'a KeyEntry,
    pub verdict: &'a str,
    pub trap_right: bool,
    /// True effects that are named, and how many there are.
    pub found: usize,
    pub wanted: usize,
    /// Whether the first that is named is one.
    pub first: bool,
    /// Whether something is named that is not there, and a deviation that is.
    pub is_false: bool,
    pub is_deviation: bool,
    /// Whether the truth is among what cannot be told from what is named.
    pub admits: bool,
}

pub(super) fn grade(stated: &Stated<'_>) -> Grade {
    let Stated { key, verdict, found, wanted, is_false, admits, .. } = *stated;
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
        _ if found >= wanted.max(1) || wanted > 0 && found > 0 && key.kind == Kind::OtherLaw => {
            if stated.first || wanted > 1 {
                Grade::Right
            } else {
                Grade::Acceptable
            }
        }
        _ if found > 0 || admits => Grade::Acceptable,
        _ if !key.is_practical && verdict == "none" => Grade::Right,
        _ if !key.is_practical && stated.is_deviation && !is_false => Grade::Acceptable,
        _ => failed,
    }
}

//! Flags of `compare`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Flags of `compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Flight logs of A, the baseline: any format that `log import` reads.
    #[arg(required = true, value_name = "A")]
    pub a: Vec<PathBuf>,
    /// Flight logs of B, to compare with A, after `--`.
    #[arg(last = true, required = true, value_name = "B")]
    pub b: Vec<PathBuf>,
    /// What aligns the page's curves.
    #[arg(long, value_enum, default_value_t = AlignChoice::Time)]
    pub align: AlignChoice,
    /// How flights of A and B are paired.
    #[arg(long, value_enum, default_value_t = PairChoice::Auto)]
    pub pair: PairChoice,
    /// Mapping of the columns of tables: a TOML file, or the name of a shipped one (motion-capture,
    /// motive).
    #[arg(long, value_name = "MAP")]
    pub mapping: Option<PathBuf>,
    /// The page to write.
    #[arg(short, long, value_name = "FILE", default_value = "compare.html")]
    pub out: PathBuf,
    /// Exits with code 10 if B is worse than A by more than chance: if the 95 % interval of the
    /// first number's difference is above zero. Refuses fewer than two flights on a side, or fewer
    /// than two pairs.
    #[arg(long)]
    pub baseline: bool,
    /// Prints the comparison as JSON.
    #[arg(long)]
    pub json: bool,
}

impl CompareArgs {
    /// The flags' defaults for these flights.
    pub fn new(a: Vec<PathBuf>, b: Vec<PathBuf>) -> Self {
        Self {
            a,
            b,
            align: AlignChoice::Time,
            pair: PairChoice::Auto,
            mapping: None,
            out: PathBuf::from("compare.html"),
            baseline: false,
            json: false,
        }
    }
}

/// What aligns the flights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum AlignChoice {
    /// Time since the trajectory's start, or since take-off.
    Time,
    /// Distance along the path.
    Position,
    /// Share of the time between start and end.
    Phase,
}

/// How flights are paired.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PairChoice {
    /// By trajectory and seed where every flight has one partner, else by trajectory, else not.
    Auto,
    /// The first of A with the first of B, and so on.
    Order,
    /// Not.
    None,
}

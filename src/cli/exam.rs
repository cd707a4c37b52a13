//! Flags of an exam.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::Args;

use super::value::{count, seconds, share};
use crate::exam::order::Kind;

/// Flags of `exam`.
#[derive(Debug, Args)]
pub struct ExamArgs {
    /// Number of cases with something to find [default: 60; of a round trip all].
    #[arg(long, value_name = "COUNT")]
    pub cases: Option<usize>,
    /// Number of cases with nothing to find.
    #[arg(long, value_name = "COUNT", default_value_t = 20)]
    pub nulls: usize,
    /// Only cases of these kinds [default: all, in fixed shares].
    #[arg(long, value_enum, value_delimiter = ',')]
    pub kinds: Vec<Kind>,
    /// Runs every effect at three strengths on both shipped vehicles instead, with logs as they
    /// are, at half their rate, with stamps 5 ms off, and with a tenth lost. Takes an hour or more.
    #[arg(long, conflicts_with = "kinds")]
    pub round_trip: bool,
    /// Diagnoses the labelled flights of this folder instead, which somebody else made: a folder
    /// for each case with vehicle.json, flight_1.tlog and so on, and key.json, graded by the script
    /// that comes with them. Nothing is drawn, and nothing is ever fitted to them.
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = ["cases", "kinds", "round_trip", "exact", "seed", "fail_on_miss"]
    )]
    pub practice: Option<PathBuf>,
    /// Decides and scores the evidence of an earlier exam's cases again; a folder that --evidence
    /// filled. Nothing is flown.
    #[arg(
        long,
        value_name = "DIR",
        conflicts_with_all = ["cases", "kinds", "round_trip", "practice", "exact", "seed"]
    )]
    pub decide: Vec<PathBuf>,
    /// The file to write, with the numbers of the decision that serve these cases best: fitted to
    /// some families of cases, tested on the others.
    #[arg(long, value_name = "FILE", requires = "decide")]
    pub calibrate: Option<PathBuf>,
    /// Diagnoses these flights of a real or simulated vehicle instead, each time with one number of
    /// its --vehicle file made wrong, and prints which errors the diagnosis finds: what such flights
    /// can show. The file should describe the vehicle well.
    #[arg(
        long,
        value_name = "LOG",
        num_args = 1..,
        requires = "vehicle",
        conflicts_with_all = [
            "cases", "kinds", "round_trip", "practice", "decide", "evidence", "exact", "seed",
            "fail_on_miss"
        ]
    )]
    pub flights: Vec<PathBuf>,
    /// The vehicle file of --flights.
    #[arg(long, value_name = "VEHICLE", requires = "flights")]
    pub vehicle: Option<PathBuf>,
    /// A log of --flights to hold out [default: the last].
    #[arg(long, value_name = "LOG", requires = "flights")]
    pub holdout: Vec<PathBuf>,
    /// Searches for laws instead, in flights of this many vehicles with a law that the catalogue
    /// lacks, and of --nulls vehicles without. Prints how much of the gap on another mission each
    /// law closes, whether it depends on what the true one does, and how often a law is invented.
    #[arg(
        long,
        value_name = "COUNT",
        conflicts_with_all = ["cases", "kinds", "round_trip", "practice", "decide", "evidence"]
    )]
    pub laws: Option<usize>,
    /// Flies this many flights instead in which the vehicle changes at an instant, and --nulls of
    /// ten minutes in which it does not. Prints how close to the true time the detector dates the
    /// change, from logs and live, and how often it reports one that is not there.
    #[arg(
        long,
        value_name = "COUNT",
        conflicts_with_all = ["cases", "kinds", "round_trip", "practice", "decide", "evidence", "laws"]
    )]
    pub onsets: Option<usize>,
    /// Diagnoses this many fleets of --vehicles instead, each with an effect that all share, and
    /// --nulls without one; some vehicles have their own effect. Prints how often the shared
    /// effects and those of single vehicles are named.
    #[arg(
        long,
        value_name = "COUNT",
        conflicts_with_all =
            ["cases", "kinds", "round_trip", "practice", "decide", "evidence", "laws", "onsets"]
    )]
    pub fleet: Option<usize>,
    /// Vehicles of a fleet.
    #[arg(
        long,
        value_name = "COUNT",
        default_value_t = 50,
        requires = "fleet",
        value_parser = count
    )]
    pub vehicles: usize,
    /// Share of a fleet's vehicles that have their own effect.
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = 0.2,
        requires = "fleet",
        value_parser = share
    )]
    pub damaged: f64,
    /// Folder for each case's key, answer and the evidence behind its verdict; created if missing.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["practice", "decide"])]
    pub evidence: Option<PathBuf>,
    /// Uses exact vehicle files instead of typical ones: every number is the vehicle's, with the
    /// bundled on-board loop, and logs without nuisances.
    #[arg(long)]
    pub exact: bool,
    /// Seed of everything that is drawn [default: from the system, and printed].
    #[arg(long)]
    pub seed: Option<u64>,
    /// Length of each of a case's flights, s.
    #[arg(long, default_value_t = 22.5, value_parser = seconds)]
    pub seconds: f64,
    /// Least and greatest strength of single effects with --exact: prediction errors that they
    /// cause over those of noise.
    #[arg(long, value_name = "RATIO", num_args = 2, default_values_t = [0.3, 30.0])]
    pub strengths: Vec<f64>,
    /// Number of simulated flights without any effect in each diagnosis [default: as `diagnose`].
    #[arg(long, value_name = "COUNT")]
    pub twins: Option<u32>,
    /// Cases in parallel [default: one for each core].
    #[arg(long, value_name = "COUNT")]
    pub jobs: Option<NonZeroUsize>,
    /// Folder for commitment.txt, the answers, key.json, summary.json and report.html; it must not
    /// hold another exam.
    #[arg(long, value_name = "DIR", default_value = "exam-out")]
    pub out: PathBuf,
    /// Keeps vehicle files and logs.
    #[arg(long)]
    pub keep: bool,
    /// Exits with code 10 if a rate or the Brier score misses its bound.
    #[arg(long, conflicts_with_all = ["fleet", "laws", "onsets"])]
    pub fail_on_miss: bool,
    /// Prints the result as JSON.
    #[arg(long)]
    pub json: bool,
}

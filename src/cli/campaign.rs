//! Flags of a campaign.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::Args;

use super::Shard;
use super::value::count;

/// Flags of `campaign`.
#[derive(Debug, Args)]
pub struct CampaignArgs {
    /// Number of flights in the campaign.
    #[arg(long, value_name = "COUNT", default_value_t = 300, value_parser = count)]
    pub flights: usize,
    /// Seed that every flight is drawn from.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Flies only every N-th flight, from the I-th: one of N workers on one folder.
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    pub shard: Shard,
    /// Folder for the rows and for the scripts of failed flights; created if missing. Flights
    /// already in it are not flown again.
    #[arg(long, value_name = "DIR", default_value = "campaign-out")]
    pub out: PathBuf,
    /// Runs in real time: a process of this program on a socket, which is stopped and killed as the
    /// scripts say, against the simulated vehicle and the link's faults.
    #[arg(long)]
    pub real_time: bool,
    /// Flights in parallel [default: one for each core; 10 in real time]. The rows do not depend on
    /// it.
    #[arg(long, value_name = "COUNT")]
    pub jobs: Option<NonZeroUsize>,
    /// Flies this fault script (JSON or TOML) instead.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["flights", "seed", "shard", "jobs", "draw"])]
    pub script: Option<PathBuf>,
    /// Prints the fault script of this flight instead of flying.
    #[arg(long, value_name = "NUMBER")]
    pub draw: Option<u64>,
    /// Prints the summary, or the script's flight, as JSON.
    #[arg(long)]
    pub json: bool,
}

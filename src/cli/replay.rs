//! Flags of `replay`.

use std::path::PathBuf;

use clap::Args;

use super::view::{VIEW_ADDRESS, view_address};

/// Flags of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Flight log, of any format that `log import` reads.
    pub log: PathBuf,
    /// Where the view is served.
    #[arg(
        long,
        value_name = "HOST:PORT",
        num_args = 0..=1,
        require_equals = true,
        default_value = VIEW_ADDRESS,
        default_missing_value = VIEW_ADDRESS,
        value_parser = view_address
    )]
    pub view: String,
    /// Waits at the start until a viewer starts playback.
    #[arg(long)]
    pub paused: bool,
    /// Mapping of a table's columns: a TOML file, or the name of a shipped one.
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
}

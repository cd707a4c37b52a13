//! Flags of `reference`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Flags of `reference`.
#[derive(Debug, Args)]
pub struct ReferenceArgs {
    /// Page to print.
    #[arg(required_unless_present = "out")]
    pub page: Option<PageChoice>,
    /// Writes every page into this folder instead, and the JSON Schemas into its folder `schemas`.
    #[arg(short, long, value_name = "DIR", conflicts_with = "page")]
    pub out: Option<PathBuf>,
}

/// A page of the reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PageChoice {
    /// The catalogue of effects: equations, parameters, units, ranges.
    Effects,
    /// The families of trajectory files.
    Trajectories,
    /// The keys of vehicle files.
    Vehicle,
    /// Every setting, with its default.
    Settings,
    /// The topics of a log and the fields of their messages.
    Topics,
    /// The exit codes.
    ExitCodes,
    /// What the commands print with --json.
    Json,
}

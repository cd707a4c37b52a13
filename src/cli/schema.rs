//! Flags of `schema`.

use clap::Args;

/// Flags of `schema`.
#[derive(Debug, Args)]
pub struct SchemaArgs {
    /// Name of the schema, such as downwash.simulate [default: lists all].
    pub name: Option<String>,
    /// Lists all as JSON.
    #[arg(long, conflicts_with = "name")]
    pub json: bool,
}

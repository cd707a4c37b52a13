//! `downwash config`: every setting and where it comes from.

use std::collections::BTreeMap;
use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;
use toml::Value;

use super::{Exit, ExitContext, print_json};
use crate::cli::ConfigArgs;
use crate::config::{Config, SCHEMA_VERSION};

#[derive(JsonSchema, Serialize)]
struct Row<'a> {
    #[schemars(with = "serde_json::Value")]
    value: &'a Value,
    origin: String,
}

#[derive(JsonSchema, Serialize)]
pub(super) struct Report<'a> {
    schema: &'static str,
    schema_version: u32,
    settings: BTreeMap<String, Row<'a>>,
}

/// Loads the configuration of a command: files, environment, then `flags`.
pub(super) fn load(
    file: Option<&Path>,
    flags: Vec<(&'static str, &str, Value)>,
) -> anyhow::Result<Config> {
    Config::load(file, std::env::vars_os(), flags).or_exit(Exit::Usage)
}

pub(super) fn run(args: &ConfigArgs) -> anyhow::Result<Exit> {
    let config = load(args.config.as_deref(), vec![])?;
    let settings: BTreeMap<_, _> = config
        .rows()
        .map(|(path, value, origin)| (path, Row { value, origin: origin.to_string() }))
        .collect();
    if args.json {
        let report = Report { schema: "downwash.config", schema_version: SCHEMA_VERSION, settings };
        print_json(&report)?;
    } else {
        let width = settings.keys().map(String::len).max().unwrap_or(0);
        for (path, row) in &settings {
            println!("{path:width$} = {}  # {}", row.value, row.origin);
        }
    }
    Ok(Exit::Ok)
}

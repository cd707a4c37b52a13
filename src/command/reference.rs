//! `downwash reference`: reference pages, generated from the code that they describe.

mod markdown;

use std::path::Path;

use anyhow::Context;
use schemars::schema_for;
use serde_json::{Map, Value};
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, Kind, Neutral, Parameter};

use self::markdown::{
    Key, Parts, cell, choices, description, head, is_required, keys, kind, properties, row,
};
use super::schema;
use super::{Exit, ExitContext, print_text};
use crate::cli::{PageChoice, ReferenceArgs};
use crate::config::{Config, Settings};
use crate::log::encoder::Topic;
use crate::log::schema::{Flat, MESSAGES, MavlinkFrameMessage};
use crate::plan::trajectory::Trajectory;

/// All pages, each with the name of its file.
const PAGES: [(PageChoice, &str); 7] = [
    (PageChoice::Effects, "effects.md"),
    (PageChoice::Trajectories, "trajectories.md"),
    (PageChoice::Vehicle, "vehicle.md"),
    (PageChoice::Settings, "settings.md"),
    (PageChoice::Topics, "topics.md"),
    (PageChoice::ExitCodes, "exit-codes.md"),
    (PageChoice::Json, "json.md"),
];

pub(super) fn run(args: &ReferenceArgs) -> anyhow::Result<Exit> {
    if let Some(page) = args.page {
        print_text(&text(page))?;
    }
    if let Some(folder) = &args.out {
        write(folder).or_exit(Exit::Failure)?;
    }
    Ok(Exit::Ok)
}

fn write(folder: &Path) -> anyhow::Result<()> {
    let put = |path: &Path, text: String| {
        std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    let schemas = folder.join("schemas");
    std::fs::create_dir_all(&schemas)
        .with_context(|| format!("cannot create the folder {}", schemas.display()))?;
    for (page, file) in PAGES {
        put(&folder.join(file), text(page))?;
    }
    for output in &schema::OUTPUTS {
        let text = serde_json::to_string_pretty(&output.schema())? + "\n";
        put(&schemas.join(format!("{}.json", output.name())), text)?;
    }
    Ok(())
}

fn text(page: PageChoice) -> String {
    let (title, body) = match page {
        PageChoice::Effects => ("Effects", effects()),
        PageChoice::Trajectories => ("Trajectory files", trajectories()),
        PageChoice::Vehicle => ("Vehicle files", vehicle()),
        PageChoice::Settings => ("Settings", settings()),
        PageChoice::Topics => ("Topics of a log", topics()),
        PageChoice::ExitCodes => ("Exit codes", exit_codes()),
        PageChoice::Json => ("JSON of the commands", json()),
    };
    format!("# {title}\n\nMade by `downwash reference` from the program itself.\n\n{body}")
}

fn effects() -> String {
    let mut page = String::from(
        "What a vehicle may do that its file does not describe. `--effect ID:PARAMETER=VALUE,...` \
         switches an effect on; so does a table `[ID]` in the file of `--effects`.\nv_a is the \
         velocity relative to the air in body axes (front, right, down), V_h its horizontal part, \
         n_i a rotor's speed as a fraction of the greatest, nr = mean(n_i) / sqrt(hover_thrust), T \
         the rotors' thrusts together.\n",
    );
    for id in EffectId::ALL {
        page += &format!("\n## {id}\n\n{}\n\n", id.about());
        page += &head(&["Parameter", "Unit", "Range", "Default"]);
        for parameter in id.spec().parameters {
            let name = format!("`{}`{}", parameter.name, shape(parameter));
            let range = format!("{} to {}", parameter.min, parameter.max);
            page += &row([&*name, parameter.unit, &range, &default_of(parameter)]);
        }
    }
    page
}

fn shape(parameter: &Parameter) -> &'static str {
    match parameter.kind {
        Kind::Scalar => "",
        Kind::Vec3 => " (three values)",
        Kind::Index => " (counted from 0)",
    }
}

fn default_of(parameter: &Parameter) -> String {
    match (parameter.default, parameter.neutral) {
        (Some(value), Neutral::Value(_)) => format!("{value} (no effect)"),
        (Some(value), _) => value.to_string(),
        (None, Neutral::Vehicle(_)) => {
            "required; the vehicle file's value means no effect".to_owned()
        }
        (None, _) => "required".to_owned(),
    }
}

fn definitions(schema: &Value) -> Map<String, Value> {
    schema["$defs"].as_object().cloned().unwrap_or_default()
}

fn key_rows<'a>(keys: impl IntoIterator<Item = &'a Key>) -> String {
    let mut table = head(&["Key", "Type", "Default", "What it is"]);
    for key in keys {
        let default = match &key.default {
            _ if key.is_required => "required".to_owned(),
            None | Some(Value::Null) => "none".to_owned(),
            Some(value) => format!("`{value}`"),
        };
        table += &row([&*format!("`{}`", key.path), &key.kind, &default, &key.about]);
    }
    table
}

fn trajectories() -> String {
    let schema = Trajectory::file_schema().to_value();
    let definitions = definitions(&schema);
    let mut page = String::from(
        "TOML, with `family` and that family's keys. Lengths in m, times in s, angles in degrees; heights \
         count from the take-off floor, positions from the take-off point. The shipped ones \
         (`config/trajectories`) go by their names.\n",
    );
    for family in schema["oneOf"].as_array().into_iter().flatten() {
        let name = family["properties"]["family"]["const"].as_str().unwrap_or_default();
        // A family whose keys have their own type, and one whose keys are in place.
        let part = markdown::referred(family).and_then(|part| definitions.get(part));
        let all = keys(part.unwrap_or(family), &definitions);
        let own = all.iter().filter(|key| key.path != "family");
        page += &format!("\n## {name}\n\n{}\n\n{}", description(family), key_rows(own));
    }
    page
}

fn vehicle() -> String {
    let schema = schema_for!(VehicleParams).to_value();
    let all = keys(&schema, &definitions(&schema));
    let intro = "TOML or JSON. `downwash vehicle init` writes one, `downwash vehicle check` says \
                 whether its numbers fit each other. `[]` means each item of a list; the four \
                 rotors are in the order of the motor outputs. `[modelled_effects.ID]` has the \
                 parameters of an [effect](effects.md) that the simulator already has.\n\n";
    intro.to_owned() + &key_rows(&all)
}

fn settings() -> String {
    let schema = schema_for!(Settings).to_value();
    let config = Config::defaults();
    let defaults: Vec<(String, Value)> = config
        .rows()
        .filter_map(|(path, value, _)| Some((path, serde_json::to_value(value).ok()?)))
        .collect();
    let mut all = keys(&schema, &definitions(&schema));
    for key in &mut all {
        let found = defaults.iter().find(|(path, _)| *path == key.path);
        key.default = found.map(|(_, value)| value.clone()).or(key.default.take());
    }
    let intro = "Layers, each overriding those before it: the built-in values, \
                 `/etc/downwash/config.toml`, `$XDG_CONFIG_HOME/downwash/config.toml`, `--config \
                 FILE`, variables such as `DOWNWASH_CONTROL__RATE_HZ=250`, flags. `downwash \
                 config` prints each value and where it comes from.\n\n";
    intro.to_owned() + &key_rows(&all)
}

fn topics() -> String {
    let mut page = String::from(
        "MCAP with protobuf; every file holds the descriptors of its messages. The world is north, \
         east, down, the body front, right, down; units are in the names; unknown values are NaN. \
         `log_time` is the host's time of arrival, `publish_time` the vehicle's time of the sample \
         on the host's clock.\n\nFor viewers there are topics of Foxglove's own messages:\n\n",
    );
    page += &head(&["Topic", "Message"]);
    for topic in Topic::ALL.into_iter().map(Topic::definition) {
        if topic.schema.starts_with("foxglove.") {
            page += &row([&*format!("`{}`", topic.topic), &format!("`{}`", topic.schema)]);
        }
    }
    let frames = "`/mavlink/rx` and `/mavlink/tx`: one frame, its header's fields and the bytes on the wire.";
    let frames = (MavlinkFrameMessage::NAME, frames, MavlinkFrameMessage::FIELDS);
    for (name, about, fields) in MESSAGES.iter().chain([&frames]) {
        page += &format!("\n## {name}\n\n{}\n\n", cell(about));
        page += &head(&["Field", "Type"]);
        for field in *fields {
            page += &row([&*format!("`{}`", field.name()), field.kind()]);
        }
    }
    page
}

fn exit_codes() -> String {
    let mut page = head(&["Exit code", "Meaning"]);
    for (code, meaning) in Exit::MEANINGS {
        page += &row([&*code.to_string(), &cell(meaning)]);
    }
    page
}

fn json() -> String {
    let link = |name: &str| format!("[{name}](#{})", name.to_lowercase());
    let table = |schema: &Value| {
        let mut table = head(&["Key", "Type", "What it is"]);
        for (name, value) in properties(schema) {
            let mark = if is_required(schema, name) { "" } else { " (may be missing)" };
            let kind = cell(&kind(value, &link)) + mark;
            table += &row([&*format!("`{name}`"), &kind, &description(value)]);
        }
        table
    };
    let mut page = String::from(
        "`downwash schema NAME` prints a JSON Schema; those of this version are in \
         [`schemas/`](schemas). Units are SI and in the names; a number that is not finite is \
         `null`. Within a `schema_version` keys may be added, and none is removed or changes its \
         meaning.\n",
    );
    let mut parts = Parts::default();
    for output in &schema::OUTPUTS {
        let schema = parts.take(output.name(), &output.schema());
        let (name, command, about) = (output.name(), output.command(), description(&schema));
        page += &format!("\n## {name}\n\n`downwash {command}`. {about}\n\n{}", table(&schema));
    }
    page += "\n# Parts of these\n";
    for (name, schema) in &parts.0 {
        let body =
            if schema.get("properties").is_some() { table(schema) } else { choices(schema, &link) };
        page += &format!("\n## {name}\n\n{}\n\n{body}", description(schema));
    }
    page
}

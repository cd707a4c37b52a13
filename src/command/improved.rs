//! The user's vehicle file with the findings of a diagnosis: everything else in it stays as
//! written.

use std::fmt;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, anyhow};
use serde::de::{self, Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value, json};
use toml_edit::{DocumentMut, InlineTable, Item, Table, TableLike};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;

use crate::diagnose::answer::Answer;
use crate::log::name::date;

/// The tables of a vehicle file for effects and for the sources of its numbers.
const EFFECTS: &str = "modelled_effects";
const PROVENANCE: &str = "provenance";

/// The format of a vehicle file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    Toml,
    Json,
}

impl Form {
    /// The format of a file by its name, else by its text, as [`VehicleParams::load`] decides it.
    pub fn of(path: &Path, text: &str) -> Self {
        match path.extension().and_then(|extension| extension.to_str()) {
            Some("toml") => Self::Toml,
            Some("json") => Self::Json,
            _ if text.trim_start().starts_with('{') => Self::Json,
            _ => Self::Toml,
        }
    }
}

/// The additions to a vehicle file: effects with their parameters, and their provenance.
pub(super) struct Additions {
    effects: Map<String, Value>,
    provenance: Map<String, Value>,
}

impl Additions {
    /// Effects without provenance.
    pub fn of_effects(effects: &EffectSet) -> anyhow::Result<Self> {
        let Value::Object(effects) = serde_json::to_value(effects).context("the effects")? else {
            return Err(anyhow!("the effects are not a table"));
        };
        Ok(Self { effects, provenance: Map::new() })
    }

    /// The named effects of an answer from `logs`, with their provenance.
    pub fn new(effects: &EffectSet, answer: &Answer, logs: &[String]) -> anyhow::Result<Self> {
        let named = answer.named().map(|effect| {
            let about = json!({
                "logs": logs,
                "probability": effect.probability,
                "intervals_90": effect.intervals,
            });
            (effect.id.name().to_owned(), about)
        });
        Self::found(effects, named)
    }

    /// Effects found now; `about` has the provenance of each, by its id.
    pub fn found(
        effects: &EffectSet,
        about: impl Iterator<Item = (String, Value)>,
    ) -> anyhow::Result<Self> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs();
        let Self { effects, .. } = Self::of_effects(effects)?;
        let found = about.filter(|(id, _)| effects.contains_key(id));
        let provenance = found.map(|(id, about)| {
            let mut source = Map::new();
            source.insert(
                "by".to_owned(),
                concat!("downwash ", env!("CARGO_PKG_VERSION"), " diagnose").into(),
            );
            source.insert("date".to_owned(), date(now).into());
            source.extend(about.as_object().cloned().unwrap_or_default());
            (format!("{EFFECTS}.{id}"), Value::Object(source))
        });
        let provenance = provenance.collect();
        Ok(Self { effects, provenance })
    }

    /// The file `text` of `vehicle` with the additions, in the format of `out`.
    pub fn to_file(
        &self,
        text: &str,
        vehicle: &VehicleParams,
        [form, out]: [Form; 2],
    ) -> anyhow::Result<String> {
        let text = if form == out {
            text.to_owned()
        } else {
            match out {
                Form::Toml => vehicle.to_toml().context("the vehicle as TOML")?,
                Form::Json => serde_json::to_string_pretty(vehicle).context("the vehicle")? + "\n",
            }
        };
        if self.effects.is_empty() {
            return Ok(text);
        }
        let added = match out {
            Form::Toml => self.to_toml(&text)?,
            Form::Json => self.to_json(&text)?,
        };
        // Reading TOML makes all line ends the same.
        Ok(if text.contains("\r\n") {
            added.replace("\r\n", "\n").replace('\n', "\r\n")
        } else {
            added
        })
    }

    fn to_toml(&self, text: &str) -> anyhow::Result<String> {
        let mut document: DocumentMut = text.parse().context("the vehicle file")?;
        for (name, additions) in [(EFFECTS, &self.effects), (PROVENANCE, &self.provenance)] {
            let item = document.entry(name).or_insert_with(|| {
                let mut table = Table::new();
                table.set_implicit(true);
                Item::Table(table)
            });
            let inline = item.is_inline_table();
            let table =
                item.as_table_like_mut().with_context(|| format!("{name} is not a table"))?;
            for (key, value) in additions {
                set(table, key, value, inline);
            }
        }
        Ok(document.to_string())
    }

    fn to_json(&self, text: &str) -> anyhow::Result<String> {
        let mut object: Ordered = serde_json::from_str(text).context("the vehicle file")?;
        let indent = indent_of(text);
        for (name, additions) in [(EFFECTS, &self.effects), (PROVENANCE, &self.provenance)] {
            let mut inner: Ordered = match object.get(name) {
                Some(raw) => serde_json::from_str(raw).context(name)?,
                None => Ordered(Vec::new()),
            };
            for (key, value) in additions {
                inner.set(key, serde_json::to_string(value).context("a value")?);
            }
            object.set(name, inner.text(indent, 1));
        }
        let end = if text.ends_with('\n') { "\n" } else { "" };
        Ok(object.text(indent, 0) + end)
    }
}

/// Sets a key of a table. An existing key keeps its place and its comments.
fn set(table: &mut dyn TableLike, key: &str, value: &Value, inline: bool) {
    let there = table.get_mut(key).filter(|item| item.is_table_like());
    match (there.and_then(Item::as_table_like_mut), value) {
        (Some(there), Value::Object(entries)) => {
            for (key, value) in entries {
                set(there, key, value, true);
            }
        }
        (None, Value::Object(entries)) if !inline => {
            let mut new = Table::new();
            for (key, value) in entries {
                new.insert(key, Item::Value(toml_value(value)));
            }
            table.insert(key, Item::Table(new));
        }
        _ => {
            let mut new = toml_value(value);
            if let Some(old) = table.get(key).and_then(Item::as_value) {
                *new.decor_mut() = old.decor().clone();
            }
            table.insert(key, Item::Value(new));
        }
    }
}

fn toml_value(value: &Value) -> toml_edit::Value {
    match value {
        // TOML has no null, and no addition is null.
        Value::Null => false.into(),
        Value::Bool(value) => (*value).into(),
        Value::Number(number) => match number.as_i64() {
            Some(integer) => integer.into(),
            None => number.as_f64().unwrap_or(f64::NAN).into(),
        },
        Value::String(text) => text.as_str().into(),
        Value::Array(values) => toml_edit::Value::Array(values.iter().map(toml_value).collect()),
        Value::Object(entries) => {
            let pairs = entries.iter().map(|(key, value)| (key.as_str(), toml_value(value)));
            toml_edit::Value::InlineTable(pairs.collect::<InlineTable>())
        }
    }
}

/// The indentation of a JSON text's first key; two spaces if the key is not on its own line.
fn indent_of(text: &str) -> &str {
    let first = text.trim_start().strip_prefix('{').unwrap_or_default();
    let blank = &first[..first.len() - first.trim_start().len()];
    blank.rsplit_once('\n').map_or("  ", |(_, indent)| indent)
}

/// A JSON object that keeps the order of its keys and the text of its values.
struct Ordered(Vec<(String, Box<RawValue>)>);

impl Ordered {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.iter().find(|(name, _)| name == key).map(|(_, value)| value.get())
    }

    /// Sets a key to JSON text.
    fn set(&mut self, key: &str, text: String) {
        let Ok(value) = RawValue::from_string(text) else { return };
        match self.0.iter_mut().find(|(name, _)| name == key) {
            Some((_, there)) => *there = value,
            None => self.0.push((key.to_owned(), value)),
        }
    }

    /// The object as text, at this depth of nesting.
    fn text(&self, indent: &str, depth: usize) -> String {
        let pad = indent.repeat(depth);
        let entries: Vec<String> = self
            .0
            .iter()
            .map(|(key, value)| {
                format!("{pad}{indent}{}: {}", Value::from(key.as_str()), value.get())
            })
            .collect();
        format!("{{\n{}\n{pad}}}", entries.join(",\n"))
    }
}

impl<'de> Deserialize<'de> for Ordered {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Ordered;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Ordered, A::Error> {
                let mut entries = Vec::new();
                while let Some((key, value)) = map.next_entry::<String, Box<RawValue>>()? {
                    if entries.iter().any(|(name, _)| *name == key) {
                        return Err(de::Error::custom(format!("{key} appears twice")));
                    }
                    entries.push((key, value));
                }
                Ok(Ordered(entries))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOML: &str = include_str!("../../config/vehicles/crazyflie.toml");

    fn additions() -> Additions {
        let object = |value: Value| value.as_object().cloned().unwrap_or_default();
        Additions {
            effects: object(json!({ "rotor_drag": { "d_xy": 0.02, "d_z": 0.01 } })),
            provenance: object(json!({
                "modelled_effects.rotor_drag": { "date": "2026-01-02", "logs": ["a.mcap"] },
            })),
        }
    }

    fn drag(vehicle: &VehicleParams) -> Value {
        serde_json::to_value(&vehicle.modelled_effects).expect("effects")["rotor_drag"].clone()
    }

    #[test]
    fn toml_edit_keeps_comments_order_and_numbers() -> anyhow::Result<()> {
        let vehicle = VehicleParams::from_toml_str(TOML)?;
        let own = format!("# My quad.\n{TOML}# Its end.\n");
        let out = additions().to_file(&own, &vehicle, [Form::Toml; 2])?;
        let kept = own.lines().filter(|line| out.lines().any(|there| there == *line)).count();
        assert_eq!(kept, own.lines().count(), "{out}");
        let improved = VehicleParams::from_toml_str(&out)?;
        assert_eq!(drag(&improved), json!({ "d_xy": 0.02, "d_z": 0.01 }));
        assert_eq!(improved.provenance["modelled_effects.rotor_drag"]["logs"][0], "a.mcap");
        Ok(())
    }

    #[test]
    fn line_endings_are_kept() -> anyhow::Result<()> {
        let vehicle = VehicleParams::from_toml_str(TOML)?;
        for (text, form) in
            [(TOML.to_owned(), Form::Toml), (serde_json::to_string_pretty(&vehicle)?, Form::Json)]
        {
            let own = text.replace('\n', "\r\n");
            let out = additions().to_file(&own, &vehicle, [form; 2])?;
            assert_eq!(out.matches('\n').count(), out.matches("\r\n").count(), "{out}");
            let plain = additions().to_file(&text, &vehicle, [form; 2])?;
            assert_eq!(out.replace("\r\n", "\n"), plain);
        }
        Ok(())
    }

    #[test]
    fn existing_effect_is_edited_in_place() -> anyhow::Result<()> {
        let text = format!(
            "{TOML}\n# By hand.\n[modelled_effects.rotor_drag]\nd_xy = 0.5 # a guess\nd_z = 1e-3\n\
             [modelled_effects.motor_lag]\ntau_s = 5.0e-2\n"
        );
        let vehicle = VehicleParams::from_toml_str(&text)?;
        let out = additions().to_file(&text, &vehicle, [Form::Toml; 2])?;
        assert!(
            out.contains("# By hand.\n[modelled_effects.rotor_drag]\nd_xy = 0.02 # a guess\n"),
            "{out}"
        );
        assert!(out.contains("tau_s = 5.0e-2\n"), "{out}");
        // An inline table stays inline.
        let rest = TOML.replace("[modelled_effects]\n", "");
        let text =
            format!("modelled_effects = {{ rotor_drag = {{ d_xy = 0.5, d_z = 1e-3 }} }}\n{rest}");
        let out = additions().to_file(&text, &vehicle, [Form::Toml; 2])?;
        assert!(
            out.starts_with("modelled_effects = { rotor_drag = { d_xy = 0.02, d_z = 0.01 } }\n"),
            "{out}"
        );
        Ok(())
    }

    #[test]
    fn json_edit_keeps_order_and_numbers() -> anyhow::Result<()> {
        let vehicle = VehicleParams::from_toml_str(TOML)?;
        let mut object: Ordered = serde_json::from_str(&serde_json::to_string(&vehicle)?)?;
        object.0.reverse();
        object.set("gravity", "9.81E0".into());
        let text = object.text("\t", 0) + "\n";
        let out = additions().to_file(&text, &vehicle, [Form::Json; 2])?;
        let improved = VehicleParams::from_json_str(&out)?;
        assert_eq!(drag(&improved), json!({ "d_xy": 0.02, "d_z": 0.01 }));
        let keys = |text: &str| -> anyhow::Result<Vec<String>> {
            let object: Ordered = serde_json::from_str(text)?;
            Ok(object.0.into_iter().map(|(key, _)| key).collect())
        };
        assert!(keys(&out)?.starts_with(&keys(&text)?), "{out}");
        for line in ["\t\"gravity\": 9.81E0,", "\t\t\"rotor_drag\": {\"d_xy\":0.02,\"d_z\":0.01}"] {
            assert!(out.lines().any(|there| there == line), "{line}: {out}");
        }
        Ok(())
    }

    #[test]
    fn no_additions_leave_the_file_unchanged() -> anyhow::Result<()> {
        let vehicle = VehicleParams::from_toml_str(TOML)?;
        let none = Additions { effects: Map::new(), provenance: Map::new() };
        assert_eq!(none.to_file(TOML, &vehicle, [Form::Toml; 2])?, TOML);
        let json = none.to_file(TOML, &vehicle, [Form::Toml, Form::Json])?;
        assert_eq!(VehicleParams::from_json_str(&json)?, vehicle);
        Ok(())
    }
}

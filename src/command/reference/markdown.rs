//! JSON Schemas as tables for people.

use std::collections::BTreeMap;

use serde_json::{Map, Value};

/// One line of a table cell.
pub fn cell(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ").replace('|', "\\|")
}

/// A row of a table.
pub fn row<'a>(cells: impl IntoIterator<Item = &'a str>) -> String {
    format!("| {} |\n", cells.into_iter().collect::<Vec<_>>().join(" | "))
}

/// The head of a table.
pub fn head(columns: &[&str]) -> String {
    row(columns.iter().copied()) + &format!("|{}\n", "---|".repeat(columns.len()))
}

/// The name of the definition that a schema refers to.
pub fn referred(schema: &Value) -> Option<&str> {
    schema["$ref"].as_str()?.rsplit('/').next()
}

pub fn description(schema: &Value) -> String {
    cell(schema["description"].as_str().unwrap_or_default())
}

fn alternatives(schema: &Value) -> Option<&Vec<Value>> {
    schema["anyOf"].as_array().or_else(|| schema["oneOf"].as_array())
}

fn distinct(words: impl Iterator<Item = String>) -> String {
    let mut all = Vec::new();
    for word in words {
        if !all.contains(&word) {
            all.push(word);
        }
    }
    all.join(" or ")
}

/// A schema's type in words; `name` formats the name of a definition.
pub fn kind(schema: &Value, name: &impl Fn(&str) -> String) -> String {
    if let Some(part) = referred(schema) {
        return name(part);
    }
    if let Some(several) = alternatives(schema) {
        return distinct(several.iter().map(|each| kind(each, name)));
    }
    if let Some(values) = schema["enum"].as_array() {
        return values
            .iter()
            .map(|value| format!("`{}`", plain(value)))
            .collect::<Vec<_>>()
            .join(", ");
    }
    if let Some(value) = schema.get("const") {
        return format!("`{}`", plain(value));
    }
    let types: Vec<&str> = match &schema["type"] {
        Value::String(one) => vec![one],
        Value::Array(several) => several.iter().filter_map(Value::as_str).collect(),
        _ => vec!["anything"],
    };
    let word = |each: &str| match each {
        "array" => match schema["prefixItems"].as_array() {
            Some(items) => {
                let items: Vec<_> = items.iter().map(|item| kind(item, name)).collect();
                format!("[{}]", items.join(", "))
            }
            None => {
                let item =
                    schema.get("items").map_or("anything".to_owned(), |item| kind(item, name));
                match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
                    (Some(least), Some(most)) if least == most => format!("list of {least} {item}"),
                    _ => format!("list of {item}"),
                }
            }
        },
        "object" if schema["additionalProperties"].is_object() => {
            format!("table of {}", kind(&schema["additionalProperties"], name))
        }
        other => other.to_owned(),
    };
    distinct(types.into_iter().map(word))
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// The keys of an object.
pub fn properties(schema: &Value) -> impl Iterator<Item = (&String, &Value)> {
    schema["properties"].as_object().into_iter().flat_map(Map::iter)
}

/// Whether a key is required.
pub fn is_required(schema: &Value, key: &str) -> bool {
    schema["required"].as_array().is_some_and(|all| all.iter().any(|each| each == key))
}

/// The accepted values, unless the value is a table.
pub fn choices(schema: &Value, name: &impl Fn(&str) -> String) -> String {
    match alternatives(schema) {
        None => format!("- {}\n", kind(schema, name)),
        Some(several) => several
            .iter()
            .map(|each| match description(each) {
                about if about.is_empty() => format!("- {}\n", kind(each, name)),
                about => format!("- {}: {about}\n", kind(each, name)),
            })
            .collect(),
    }
}

/// One key of a file, with the path of its tables.
pub struct Key {
    /// The path with dots; `[]` stands for each element of a list.
    pub path: String,
    pub kind: String,
    pub is_required: bool,
    /// The default of the schema, if it has one.
    pub default: Option<Value>,
    pub about: String,
}

/// Every key of a file that follows `schema`, with `definitions` resolved.
pub fn keys(schema: &Value, definitions: &Map<String, Value>) -> Vec<Key> {
    let mut all = Vec::new();
    add_keys("", schema, definitions, &mut all);
    all
}

fn add_keys(prefix: &str, schema: &Value, definitions: &Map<String, Value>, all: &mut Vec<Key>) {
    let is_optional = |schema: &Value| {
        let named = alternatives(schema)?.iter().find(|each| referred(each).is_some())?;
        Some(named.clone())
    };
    for (key, value) in properties(schema) {
        let path = format!("{prefix}{key}");
        let whole = is_optional(value).unwrap_or_else(|| value.clone());
        let (inner, list) = match &whole["items"] {
            Value::Null => (&whole, ""),
            items => (items, "[]"),
        };
        let part = referred(inner).and_then(|name| definitions.get(name));
        if let Some(part) = part.filter(|part| part.get("properties").is_some()) {
            add_keys(&format!("{path}{list}."), part, definitions, all);
            continue;
        }
        let about = match part.filter(|part| is_choice(part)) {
            None => description(value),
            Some(part) => cell(&format!("{} {}", description(value), choices_in_line(part))),
        };
        let words = |name: &str| match definitions.get(name) {
            Some(part) if is_choice(part) => "word".to_owned(),
            Some(part) => kind(part, &|name: &str| name.to_owned()),
            None => name.to_owned(),
        };
        all.push(Key {
            path,
            kind: cell(&kind(value, &words)),
            is_required: is_required(schema, key),
            default: value.get("default").cloned(),
            about,
        });
    }
}

fn is_choice(schema: &Value) -> bool {
    alternatives(schema).is_some() || schema.get("enum").is_some()
}

/// The values of a choice and their meanings.
fn choices_in_line(schema: &Value) -> String {
    let name = |name: &str| name.to_owned();
    let one = |each: &Value| match description(each) {
        about if about.is_empty() => kind(each, &name),
        about => format!("{}: {about}", kind(each, &name)),
    };
    alternatives(schema).map_or_else(
        || kind(schema, &name),
        |all| all.iter().map(one).collect::<Vec<_>>().join(" "),
    )
}

/// Schemas of one page, whose definitions have unique names.
#[derive(Default)]
pub struct Parts(pub BTreeMap<String, Value>);

impl Parts {
    /// Adds a schema's definitions; renames one whose name is taken.
    pub fn take(&mut self, owner: &str, schema: &Value) -> Value {
        let mut text = schema.to_string();
        let definitions = schema["$defs"].as_object().cloned().unwrap_or_default();
        let mut renamed = Vec::new();
        for (name, body) in &definitions {
            if self.0.get(name).is_some_and(|other| other != body) {
                let own: String =
                    owner.split('.').skip(1).map(capitalised).collect::<String>() + name;
                text = text.replace(&format!("\"#/$defs/{name}\""), &format!("\"#/$defs/{own}\""));
                renamed.push((name.clone(), own));
            }
        }
        // Replacing names keeps valid JSON valid.
        let schema: Value = serde_json::from_str(&text).unwrap_or_default();
        for (name, body) in schema["$defs"].as_object().into_iter().flat_map(Map::iter) {
            let own = renamed.iter().find(|(old, _)| old == name).map_or(name, |(_, own)| own);
            self.0.insert(own.clone(), body.clone());
        }
        schema
    }
}

fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

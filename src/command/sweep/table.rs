//! The table of a sweep: a line for each point, in their order.

use std::collections::BTreeMap;

use anyhow::Context;
use serde_json::Value;

use super::Line;

/// Keys of a row that are left out: they are the same in each row, name files, or differ at each
/// try.
const LEFT_OUT: [&str; 5] = ["schema", "schema_version", "log", "report", "seconds"];

/// The table as CSV. Its columns are the point's number, the failure, the seed, the varied inputs
/// (`input.`), and the results, with a dot for nested tables.
pub fn csv(
    rows: &BTreeMap<usize, Line>,
    seed_of: impl Fn(usize) -> u64,
) -> anyhow::Result<Vec<u8>> {
    let lines = rows.values().map(|line| cells(line, seed_of(line.index)));
    let lines: Vec<Vec<(String, String)>> = lines.collect();
    let mut columns: Vec<&str> = Vec::new();
    let mut places: BTreeMap<&str, usize> = BTreeMap::new();
    // Complete rows first, so that a failure changes the place of no column.
    let complete = rows.values().zip(&lines).filter(|(row, _)| row.failure.is_none());
    for line in complete.map(|(_, line)| line).chain(&lines) {
        for (name, _) in line {
            places.entry(name).or_insert_with(|| {
                columns.push(name);
                columns.len() - 1
            });
        }
    }
    let mut out = csv::Writer::from_writer(Vec::new());
    out.write_record(&columns).context("the table")?;
    for line in &lines {
        let mut record = vec![""; columns.len()];
        for (name, value) in line {
            if let Some(cell) = places.get(name.as_str()).and_then(|place| record.get_mut(*place)) {
                *cell = value;
            }
        }
        out.write_record(&record).context("the table")?;
    }
    out.into_inner().context("the table")
}

fn cells(line: &Line, seed: u64) -> Vec<(String, String)> {
    let mut cells = vec![
        ("point".to_owned(), line.index.to_string()),
        ("failure".to_owned(), line.failure.clone().unwrap_or_default()),
    ];
    // A flight's row has its own seed.
    if line.row.as_ref().is_none_or(|row| row.get("seed").is_none()) {
        cells.push(("seed".to_owned(), seed.to_string()));
    }
    for (path, value) in &line.inputs {
        flatten(&format!("input.{path}"), value, &mut cells);
    }
    let row = line.row.iter().filter_map(Value::as_object).flatten();
    for (key, value) in row.filter(|(key, _)| !LEFT_OUT.contains(&key.as_str())) {
        flatten(key, value, &mut cells);
    }
    cells
}

fn flatten(name: &str, value: &Value, cells: &mut Vec<(String, String)>) {
    match value {
        Value::Object(inner) => {
            inner.iter().for_each(|(key, value)| flatten(&format!("{name}.{key}"), value, cells));
        }
        Value::Array(inner) => {
            let all = inner.iter().enumerate();
            all.for_each(|(index, value)| flatten(&format!("{name}.{index}"), value, cells));
        }
        Value::Null => cells.push((name.to_owned(), String::new())),
        Value::String(text) => cells.push((name.to_owned(), text.clone())),
        other => cells.push((name.to_owned(), other.to_string())),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn failed_point_gets_a_csv_line() -> anyhow::Result<()> {
        let line = |index: usize, failure: Option<&str>, row: Option<Value>| Line {
            index,
            inputs: BTreeMap::from([("vehicle".to_owned(), json!("a,b"))]),
            failure: failure.map(str::to_owned),
            row,
        };
        let row = json!({ "schema": "x", "seed": 9, "end": "done", "effects": { "wind": { "n": [1.5, 2] } }, "log": null });
        let rows = [line(0, Some("no file"), None), line(1, None, Some(row))];
        let rows = rows.into_iter().map(|line| (line.index, line)).collect();
        let expected = "point,failure,input.vehicle,end,effects.wind.n.0,effects.wind.n.1,seed\n\
                        0,no file,\"a,b\",,,,8\n1,,\"a,b\",done,1.5,2,9\n";
        let table = String::from_utf8(csv(&rows, |index| 8 + index as u64)?)?;
        let sorted = |text: &str| {
            let mut names: Vec<String> =
                text.lines().next().unwrap_or("").split(',').map(str::to_owned).collect();
            names.sort();
            names
        };
        // serde_json sorts the keys of a value.
        assert_eq!(sorted(&table), sorted(expected));
        let failed = table.lines().nth(1).unwrap_or_default();
        assert!(failed.starts_with("0,no file,\"a,b\",") && failed.contains('8'), "{table}");
        Ok(())
    }
}

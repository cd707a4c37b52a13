//! The manifest: what is done at each point, its inputs, and which of them vary.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};
use toml::{Table, Value};
use vehicle::bounded;
use vehicle::effects::{EffectError, EffectId, EffectSet};

use super::axis::{Axis, Drawn, POINTS_MAX, Seeds};
use super::exam_inputs;
use super::named_files::NamedFiles;
use super::subject::Subject;
use crate::log::descriptor::hex;

/// Version of the manifest's format.
const VERSION: u32 = 1;

/// The manifest as written.
#[derive(Debug, Deserialize)]
struct Written {
    schema_version: u32,
    /// What is done at each point.
    #[serde(default)]
    of: Subject,
    /// Inputs of which all combinations are used.
    #[serde(default)]
    grid: BTreeMap<String, Axis>,
    /// Inputs that vary together, row by row.
    #[serde(default)]
    list: BTreeMap<String, Vec<Value>>,
    /// Inputs that are drawn at random.
    #[serde(default)]
    draw: BTreeMap<String, Drawn>,
    /// Number of draws; they are the same at each place of grid and list.
    #[serde(default = "one")]
    samples: usize,
    /// Seed of the draws.
    #[serde(default = "one_seed")]
    draw_seed: u64,
    /// Seeds of each point: a number of them from 1 on, or a list.
    #[serde(default)]
    seeds: Seeds,
    /// Inputs that are the same at each point.
    #[serde(flatten)]
    fixed: Table,
}

fn one() -> usize {
    1
}

fn one_seed() -> u64 {
    1
}

/// The points of a sweep.
#[derive(Debug)]
pub struct Manifest {
    files: NamedFiles,
    written: Written,
    grid: Vec<(String, Vec<Value>)>,
    rows: usize,
    seeds: Vec<u64>,
    /// Points of each seed: the cases of an exam.
    cases: usize,
    /// Number of points.
    pub points: usize,
    /// Hash of its text and of the files that it names.
    pub sha256: String,
}

/// One flight of a sweep, one diagnosis, or one case of an exam.
#[derive(Clone, Debug)]
pub struct Point {
    /// The varied inputs, by their paths.
    pub varied: BTreeMap<String, Value>,
    /// Its seed.
    pub seed: u64,
    /// Number of the case in the seed's exam.
    pub case: usize,
}

impl Manifest {
    /// Reads a manifest.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let text = bounded::read_to_string(path, bounded::WRITTEN_MAX)
            .with_context(|| format!("cannot read the manifest {}", path.display()))?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Self::parse(&text, folder).with_context(|| format!("manifest {}", path.display()))
    }

    /// A manifest's text; its paths begin in `folder`.
    pub fn parse(text: &str, folder: PathBuf) -> anyhow::Result<Self> {
        let files = NamedFiles::of(folder);
        let mut written: Written = toml::from_str(text)?;
        if written.schema_version != VERSION {
            bail!("schema_version: expected {VERSION}, found {}", written.schema_version);
        }
        written.check_paths()?;
        if let Some(Value::Table(set)) = written.fixed.get_mut("set") {
            *set = dotted("", set);
        }
        let grid = written.grid.iter().map(|(path, axis)| {
            if matches!(axis, Axis::Pattern(_)) && !written.of.files().contains(&path.as_str()) {
                bail!("grid.{path:?}: expected a list of values");
            }
            let values = axis.values(files.folder()).with_context(|| format!("grid.{path:?}"))?;
            Ok((path.clone(), values))
        });
        let grid = grid.collect::<anyhow::Result<Vec<_>>>()?;
        let rows = written.rows()?;
        for (path, drawn) in &written.draw {
            drawn.check().with_context(|| format!("draw.{path:?}"))?;
        }
        if written.draw.is_empty() && written.samples != 1 {
            bail!("samples: expected 1, because nothing is drawn, found {}", written.samples);
        }
        let seeds = written.seeds.each();
        if let Seeds::These(listed) = &written.seeds {
            let mut distinct = BTreeSet::new();
            if let Some(seed) = listed.iter().find(|seed| !distinct.insert(**seed)) {
                bail!("seeds: {seed} is given twice, and would only repeat the same points");
            }
        }
        let cases = match written.of {
            Subject::Exam => exam_inputs::cases(&written.fixed)?,
            Subject::Simulate | Subject::Diagnose => 1,
        };
        let lengths = grid.iter().map(|(_, values)| values.len());
        let lengths = lengths.chain([rows, written.samples, seeds.len(), cases]);
        let points = lengths.fold(1_usize, usize::saturating_mul);
        if !(1..=POINTS_MAX).contains(&points) {
            bail!("expected 1 to {POINTS_MAX} points, found {points}");
        }
        let mut manifest =
            Self { files, written, grid, rows, seeds, cases, points, sha256: String::new() };
        manifest.sha256 = manifest.hash(text);
        Ok(manifest)
    }

    /// The files that its inputs name.
    pub(super) fn files(&self) -> &NamedFiles {
        &self.files
    }

    /// What is done at each point.
    pub(super) fn subject(&self) -> Subject {
        self.written.of
    }

    /// The point with this number. The cases of an exam vary fastest, then seeds, draws, rows of
    /// the list, and the grid, whose last input varies first.
    pub fn point(&self, index: usize) -> Point {
        let mut left = index;
        let mut next = |length: usize| {
            let at = left % length;
            left /= length;
            at
        };
        let case = next(self.cases);
        let seed = self.seeds[next(self.seeds.len())];
        let sample = next(self.written.samples);
        let row = next(self.rows);
        let mut varied = BTreeMap::new();
        for (path, values) in self.grid.iter().rev() {
            varied.insert(path.clone(), values[next(values.len())].clone());
        }
        for (path, values) in &self.written.list {
            varied.insert(path.clone(), values[row].clone());
        }
        if !self.written.draw.is_empty() {
            // Each sample has its own random stream, so a point needs no draws before it. The draw
            // is the same at every place of the grid, so differences there do not come from the
            // draw.
            let stream = self.written.draw_seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let mut rng = Pcg64Mcg::seed_from_u64(stream.wrapping_add(sample as u64));
            for (path, drawn) in &self.written.draw {
                varied.insert(path.clone(), drawn.draw(&mut rng));
            }
        }
        Point { varied, seed, case }
    }

    /// The inputs at a point, in the type of their subject.
    ///
    /// # Errors
    /// An input has the wrong type.
    pub fn inputs<T: DeserializeOwned>(&self, point: &Point) -> anyhow::Result<T> {
        let mut inputs = self.written.fixed.clone();
        for (path, value) in &point.varied {
            match path.split_once('.') {
                Some(("set", setting)) => {
                    let set = inputs.entry("set").or_insert_with(|| Value::Table(Table::new()));
                    let set = set.as_table_mut().context("set is not a table")?;
                    set.insert(setting.to_owned(), value.clone());
                }
                _ => insert(&mut inputs, path, value)?,
            }
        }
        Ok(Value::Table(inputs).try_into()?)
    }

    /// Hash of the text and of every file that a point may name.
    fn hash(&self, text: &str) -> String {
        let mut hash = Sha256::new();
        hash.update(text);
        let written = &self.written;
        let is_file = |path: &str| written.of.files().contains(&path);
        let fixed = written.fixed.iter().map(|(path, value)| (path, std::slice::from_ref(value)));
        let varied = self.grid.iter().map(|(path, values)| (path, values.as_slice()));
        let listed = written.list.iter().map(|(path, values)| (path, values.as_slice()));
        let chosen = written.draw.iter().filter_map(|(path, drawn)| match drawn {
            Drawn::Choice(values) => Some((path, values.as_slice())),
            _ => None,
        });
        let all = fixed.chain(varied).chain(listed).chain(chosen);
        for (input, values) in all.filter(|(path, _)| is_file(path)) {
            for name in values.iter().flat_map(names) {
                hash.update(name);
                written.of.hash(input, name, &self.files, &mut hash);
            }
        }
        hex(&hash.finalize())
    }
}

/// A word, or the words of a list.
fn names(value: &Value) -> Vec<&str> {
    let one = value.as_str();
    let many = value.as_array().into_iter().flatten().filter_map(Value::as_str);
    one.into_iter().chain(many).collect()
}

impl Written {
    /// Rows of the list; 1 without one.
    fn rows(&self) -> anyhow::Result<usize> {
        let mut lengths = self.list.values().map(Vec::len);
        let Some(first) = lengths.next() else { return Ok(1) };
        if lengths.any(|length| length != first) {
            bail!("list: expected the same number of values for each input");
        }
        Ok(first)
    }

    /// Refuses an unknown input, and an input that varies in two ways.
    fn check_paths(&self) -> anyhow::Result<()> {
        let paths = || self.grid.keys().chain(self.list.keys()).chain(self.draw.keys());
        for path in self.fixed.keys() {
            if !self.of.is_fixed_input(path) {
                return Err(anyhow!("{path:?}: expected {}", self.of.fixed_text()));
            }
        }
        for path in paths() {
            if !self.of.is_input(path) {
                return Err(anyhow!("{path:?}: expected {}", self.of.inputs_text()));
            }
            if paths().filter(|other| *other == path).count() > 1 {
                bail!("{path:?} varies in two ways");
            }
            if let Some(effect) = path.strip_prefix("effects.") {
                check_effect(effect)?;
            }
        }
        let fixed = self.fixed.get("effects").and_then(Value::as_table).into_iter().flatten();
        for (id, parameters) in fixed {
            check_effect(id)?;
            let names = parameters.as_table().into_iter().flat_map(Table::keys);
            names.map(|name| format!("{id}.{name}")).try_for_each(|path| check_effect(&path))?;
        }
        Ok(())
    }
}

/// Refuses an unknown effect or parameter, which would fail at every point.
fn check_effect(path: &str) -> anyhow::Result<()> {
    let (id, parameter) = path.split_once('.').map_or((path, None), |(id, rest)| (id, Some(rest)));
    if id == EffectSet::LAW {
        return Ok(());
    }
    let id: EffectId = id.parse()?;
    match parameter {
        Some(name) if id.spec().find(name).is_none() => {
            Err(EffectError::UnknownParameter { effect: id, parameter: name.to_owned() }.into())
        }
        _ => Ok(()),
    }
}

/// Sets a key in a table of tables by its dotted path.
fn insert(table: &mut Table, path: &str, value: &Value) -> anyhow::Result<()> {
    let Some((head, rest)) = path.split_once('.') else {
        table.insert(path.to_owned(), value.clone());
        return Ok(());
    };
    let inner = table.entry(head).or_insert_with(|| Value::Table(Table::new()));
    insert(inner.as_table_mut().with_context(|| format!("{head} is not a table"))?, rest, value)
}

/// Leaves of a table of tables by their dotted paths.
fn dotted(prefix: &str, table: &Table) -> Table {
    let mut found = Table::new();
    for (key, value) in table {
        let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            Value::Table(inner) => found.extend(dotted(&path, inner)),
            value => {
                found.insert(path, value.clone());
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> anyhow::Result<Manifest> {
        Manifest::parse(&format!("schema_version = 1\n{text}"), PathBuf::new())
    }

    #[test]
    fn points_cover_every_combination_once() -> anyhow::Result<()> {
        let manifest = parse(
            "seeds = [5, 9]\n[grid]\ntrajectory = ['hover', 'figure-8']\n\
             'effects.mass.mass_kg' = { from = 0.03, to = 0.05, count = 3 }\n\
             [list]\n'set.control.thrust' = [0.2, 0.3]\n'effects.wind.north_m_s' = [1, 2]\n",
        )?;
        assert_eq!(manifest.points, 2 * 2 * 3 * 2);
        let points: Vec<Point> = (0..manifest.points).map(|k| manifest.point(k)).collect();
        let distinct: BTreeSet<String> = points.iter().map(|point| format!("{point:?}")).collect();
        assert_eq!(distinct.len(), manifest.points);
        for point in &points {
            let inputs = crate::command::sweep::simulation::inputs(&manifest, point)?;
            let wind = inputs.effects.value(vehicle::effects::EffectId::Wind, "north_m_s", 0);
            let thrust = inputs.settings["control.thrust"].as_float();
            // The list varies row by row.
            assert!([(Some(1.0), Some(0.2)), (Some(2.0), Some(0.3))].contains(&(wind, thrust)));
        }
        Ok(())
    }

    #[test]
    fn draws_depend_on_the_sample_but_not_the_seed() -> anyhow::Result<()> {
        let manifest = parse(
            "seeds = 3\nsamples = 50\n[draw]\n'effects.wind.north_m_s' = { normal = [1.0, 0.5] }\n\
             'set.control.thrust' = { log_uniform = [0.1, 0.4] }\n\
             trajectory = { choice = ['hover', 'figure-8'] }\n",
        )?;
        let drawn = |k: usize| manifest.point(k).varied;
        assert_eq!(drawn(0), drawn(2));
        let distinct: BTreeSet<String> = (0..50)
            .map(|sample| format!("{:?}", drawn(3 * sample)["effects.wind.north_m_s"]))
            .collect();
        assert_eq!(distinct.len(), 50);
        for k in 0..manifest.points {
            let thrust = drawn(k)["set.control.thrust"].as_float().unwrap_or_default();
            assert!((0.1..=0.4).contains(&thrust));
        }
        Ok(())
    }

    #[test]
    fn unsweepable_settings_are_refused_by_name() {
        let refused = |text: &str| format!("{:#}", parse(text).expect_err("refused"));
        assert!(refused("[grid]\nspeed = [1]\n").contains("\"speed\": expected vehicle"));
        assert!(refused("[grid]\nvehicle = ['a']\n[list]\nvehicle = ['b']").contains("two ways"));
        assert!(
            refused("[list]\nvehicle = ['b']\n'set.a' = [1, 2]").contains("same number of values")
        );
        assert!(refused("samples = 3").contains("nothing is drawn"));
        assert!(refused("seeds = 0").contains("found 0"));
        assert!(refused("seeds = -1").contains("a list of seeds"));
        assert!(refused("seeds = [4, 2, 4]").contains("seeds: 4 is given twice"));
        assert!(refused("[grid]\n'set.a' = 3").contains("a list of values"));
        assert!(
            refused("[grid]\n'effects.wnd.north_m_s' = [1]").contains("unknown effect \"wnd\"")
        );
        assert!(
            refused("[draw]\n'effects.wind.north' = { normal = [0, 1] }").contains("\"north\"")
        );
        assert!(refused("effects = { wind = { north = 1 } }").contains("\"north\""));
        assert!(refused("[draw]\n'set.a' = { uniform = [-1e308, 1e308] }").contains("finite"));
        assert!(
            refused("[grid]\n'set.a' = { from = -1e308, to = 1e308, count = 3 }")
                .contains("finite")
        );
        assert!(refused("seeds = 100000000").contains("10000000 points"));
        assert!(refused("[draw]\n'set.a' = { uniform = [2, 1] }").contains("in their order"));
        assert!(
            refused("[grid]\n'set.a' = { from = 0, to = 1, count = 2, log = true }")
                .contains("log")
        );
        assert!(refused("speed = 1").contains("speed"));
    }

    #[test]
    fn manifest_hash_covers_the_referenced_files() -> anyhow::Result<()> {
        let folder = std::env::temp_dir().join(format!("downwash-manifest-{}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        let hash = |mass: &str| {
            std::fs::write(folder.join("v.toml"), mass)?;
            let text = "schema_version = 1\nvehicle = 'v.toml'\n";
            anyhow::Ok(Manifest::parse(text, folder.clone())?.sha256)
        };
        let hashes = [hash("mass = 1")?, hash("mass = 2")?, hash("mass = 1")?];
        std::fs::remove_dir_all(&folder)?;
        assert_ne!(hashes[0], hashes[1]);
        assert_eq!(hashes[0], hashes[2]);
        Ok(())
    }
}

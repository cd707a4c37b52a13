//! The manifest: inputs of `simulate`, and which of them vary.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64Mcg;
use serde::Deserialize;
use sha2::{Digest, Sha256};
use toml::{Table, Value};
use vehicle::effects::EffectSet;

use crate::command::simulate::Inputs;
use crate::log::descriptor::hex;

/// Version of the manifest's form.
const VERSION: u32 = 1;
/// Most points of a sweep.
const POINTS_MAX: usize = 10_000_000;
/// Inputs that are files or the names of shipped ones.
const FILES: [&str; 4] = ["vehicle", "trajectory", "config", "sitl_config"];

/// As it is written.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    schema_version: u32,
    vehicle: Option<String>,
    trajectory: Option<String>,
    config: Option<String>,
    sitl_config: Option<String>,
    /// Effects of every flight, as of an effects file.
    #[serde(default)]
    effects: Table,
    /// Settings of every flight, by their dotted paths.
    #[serde(default)]
    set: Table,
    /// Inputs that are crossed with one another.
    #[serde(default)]
    grid: BTreeMap<String, Axis>,
    /// Inputs that go together, row by row.
    #[serde(default)]
    list: BTreeMap<String, Vec<Value>>,
    /// Inputs that are drawn.
    #[serde(default)]
    draw: BTreeMap<String, Drawn>,
    /// Draws, the same at each place of grid and list.
    #[serde(default = "one")]
    samples: usize,
    /// Seed of the draws.
    #[serde(default = "one_seed")]
    draw_seed: u64,
    /// Seeds of each point: so many from 1 on, or these.
    #[serde(default)]
    seeds: Seeds,
}

fn one() -> usize {
    1
}

fn one_seed() -> u64 {
    1
}

/// Values on a grid.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Axis {
    Values(Vec<Value>),
    Range(Range),
}

/// Evenly spaced values, both ends among them.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Range {
    from: f64,
    to: f64,
    count: usize,
    /// Evenly spaced in their logarithm.
    #[serde(default)]
    log: bool,
}

/// A distribution.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Drawn {
    /// Between two numbers.
    Uniform([f64; 2]),
    /// Between two numbers, evenly in the logarithm.
    LogUniform([f64; 2]),
    /// Mean and standard deviation.
    Normal([f64; 2]),
    /// One of these.
    Choice(Vec<Value>),
}

#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Seeds {
    Count(u64),
    These(Vec<u64>),
}

impl Default for Seeds {
    fn default() -> Self {
        Self::Count(1)
    }
}

/// What is flown, point by point.
#[derive(Debug)]
pub struct Manifest {
    folder: PathBuf,
    written: Written,
    grid: Vec<(String, Vec<Value>)>,
    rows: usize,
    seeds: Vec<u64>,
    /// Number of points.
    pub points: usize,
    /// Of its text and of the files that it names.
    pub sha256: String,
}

/// One flight of a sweep.
#[derive(Clone, Debug)]
pub struct Point {
    /// What varies, by its path.
    pub varied: BTreeMap<String, Value>,
    /// Seed of the flight.
    pub seed: u64,
}

impl Manifest {
    /// Reads a manifest.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let text = std::fs::read_to_string(path)
            .with_context(|| format!("cannot read the manifest {}", path.display()))?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        Self::parse(&text, folder).with_context(|| format!("manifest {}", path.display()))
    }

    /// A manifest's text; its paths begin in `folder`.
    pub fn parse(text: &str, folder: PathBuf) -> anyhow::Result<Self> {
        let written: Written = toml::from_str(text)?;
        if written.schema_version != VERSION {
            bail!("schema_version: expected {VERSION}, found {}", written.schema_version);
        }
        let grid = written.grid.iter().map(|(path, axis)| {
            let values = axis.values().with_context(|| format!("grid.{path:?}"))?;
            Ok((path.clone(), values))
        });
        let grid = grid.collect::<anyhow::Result<Vec<_>>>()?;
        let rows = written.rows()?;
        written.check_paths()?;
        for (path, drawn) in &written.draw {
            drawn.check().with_context(|| format!("draw.{path:?}"))?;
        }
        if written.draw.is_empty() && written.samples != 1 {
            bail!("samples: expected 1, as nothing is drawn, found {}", written.samples);
        }
        let seeds = match &written.seeds {
            Seeds::Count(count) => (1..=*count.min(&(POINTS_MAX as u64 + 1))).collect(),
            Seeds::These(seeds) => seeds.clone(),
        };
        let lengths = grid.iter().map(|(_, values)| values.len());
        let lengths = lengths.chain([rows, written.samples, seeds.len()]);
        let points = lengths.fold(1_usize, usize::saturating_mul);
        if !(1..=POINTS_MAX).contains(&points) {
            bail!("expected 1 to {POINTS_MAX} points, found {points}");
        }
        let mut manifest =
            Self { folder, written, grid, rows, seeds, points, sha256: String::new() };
        manifest.sha256 = manifest.hash(text);
        Ok(manifest)
    }

    /// The flight of this number: seeds vary first, then draws, rows of the list, and the grid, the
    /// last of its inputs first.
    pub fn point(&self, index: usize) -> Point {
        let mut left = index;
        let mut next = |length: usize| {
            let at = left % length;
            left /= length;
            at
        };
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
            // Each sample has a stream of its own, so that a point is drawn without those before it,
            // and the same one at every place of the grid: what differs there is not the draw.
            let stream = self.written.draw_seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let mut rng = Pcg64Mcg::seed_from_u64(stream.wrapping_add(sample as u64));
            for (path, drawn) in &self.written.draw {
                varied.insert(path.clone(), drawn.draw(&mut rng));
            }
        }
        Point { varied, seed }
    }

    /// What `simulate` is given at a point.
    pub fn inputs(&self, point: &Point) -> anyhow::Result<Inputs> {
        let written = &self.written;
        let mut files: BTreeMap<&str, String> = BTreeMap::new();
        let fixed = [&written.vehicle, &written.trajectory, &written.config, &written.sitl_config];
        for (name, file) in FILES.into_iter().zip(fixed) {
            files.extend(file.clone().map(|file| (name, file)));
        }
        let mut effects = written.effects.clone();
        let mut settings = dotted("", &written.set);
        for (path, value) in &point.varied {
            match (path.split_once('.'), path.as_str()) {
                (Some(("effects", inner)), _) => insert(&mut effects, inner, value)?,
                (Some(("set", key)), _) => {
                    settings.insert(key.to_owned(), value.clone());
                }
                (_, name) => {
                    let name = FILES.into_iter().find(|file| *file == name);
                    let text = value.as_str().context("expected a file or a name")?;
                    files.extend(name.map(|name| (name, text.to_owned())));
                }
            }
        }
        let file = |name: &str| files.get(name).map(|file| self.resolved(file));
        let effects = EffectSet::deserialize(Value::Table(effects)).context("effects")?;
        Ok(Inputs {
            vehicle: file("vehicle"),
            trajectory: file("trajectory"),
            effects,
            onsets: Vec::new(),
            sitl_config: file("sitl_config"),
            config: file("config"),
            settings,
            seed: point.seed,
        })
    }

    /// A file beside the manifest, else what it is called.
    fn resolved(&self, file: &str) -> PathBuf {
        let beside = self.folder.join(file);
        if beside.exists() { beside } else { PathBuf::from(file) }
    }

    /// Hash of the text and of every file that a point may name.
    fn hash(&self, text: &str) -> String {
        let mut hash = Sha256::new();
        hash.update(text);
        let written = &self.written;
        let fixed = [&written.vehicle, &written.trajectory, &written.config, &written.sitl_config];
        let mut files: Vec<&str> = fixed.into_iter().flatten().map(String::as_str).collect();
        let varied = self.grid.iter().map(|(path, values)| (path, values));
        let varied = varied.chain(&written.list);
        let chosen = written.draw.iter().filter_map(|(path, drawn)| match drawn {
            Drawn::Choice(values) => Some((path, values)),
            _ => None,
        });
        for (_, values) in varied.chain(chosen).filter(|(path, _)| FILES.contains(&path.as_str())) {
            files.extend(values.iter().filter_map(Value::as_str));
        }
        for file in files {
            hash.update(file);
            hash.update(std::fs::read(self.resolved(file)).unwrap_or_default());
        }
        hex(&hash.finalize())
    }
}

impl Written {
    /// Rows of the list; 1 without one.
    fn rows(&self) -> anyhow::Result<usize> {
        let mut lengths = self.list.values().map(Vec::len);
        let Some(first) = lengths.next() else { return Ok(1) };
        if lengths.any(|length| length != first) {
            bail!("list: expected as many values of each input");
        }
        Ok(first)
    }

    /// Refuses what is no input, and an input that varies in two ways.
    fn check_paths(&self) -> anyhow::Result<()> {
        let paths = || self.grid.keys().chain(self.list.keys()).chain(self.draw.keys());
        for path in paths() {
            let inner = path.split_once('.').map(|(head, _)| head);
            let is_known =
                matches!(inner, Some("effects" | "set")) || FILES.contains(&path.as_str());
            if !is_known {
                bail!(
                    "{path:?}: expected {}, effects.ID.PARAMETER or set.SETTING; seeds vary by `seeds`",
                    FILES.join(", ")
                );
            }
            if paths().filter(|other| *other == path).count() > 1 {
                bail!("{path:?} varies in two ways");
            }
        }
        Ok(())
    }
}

impl Axis {
    fn values(&self) -> anyhow::Result<Vec<Value>> {
        match self {
            Self::Values(values) => Ok(values.clone()),
            Self::Range(Range { from, to, count, log }) => {
                let is_possible = from.is_finite() && to.is_finite() && *count > 0;
                if !is_possible || *log && !(*from > 0.0 && *to > 0.0) || *count > POINTS_MAX {
                    bail!(
                        "expected finite numbers, above 0 with log, and a count, found {from}, {to} \
                         and {count}"
                    );
                }
                let share = |k: usize| k as f64 / (*count - 1).max(1) as f64;
                let value = |k: usize| match (k, *log) {
                    (0, _) => *from,
                    (k, _) if k == count - 1 => *to,
                    (k, true) => from * (to / from).powf(share(k)),
                    (k, false) => from + (to - from) * share(k),
                };
                Ok((0..*count).map(|k| Value::Float(value(k))).collect())
            }
        }
    }
}

impl Drawn {
    fn check(&self) -> anyhow::Result<()> {
        match self {
            Self::Uniform([low, high]) if low.is_finite() && high.is_finite() && low <= high => {
                Ok(())
            }
            Self::LogUniform([low, high]) if *low > 0.0 && high.is_finite() && low <= high => {
                Ok(())
            }
            Self::Normal([mean, deviation])
                if mean.is_finite() && deviation.is_finite() && *deviation >= 0.0 =>
            {
                Ok(())
            }
            Self::Choice(values) if !values.is_empty() => Ok(()),
            other => Err(anyhow!(
                "expected finite bounds in their order, above 0 for log_uniform, a deviation of at \
                 least 0, or something to choose from, found {other:?}"
            )),
        }
    }

    fn draw(&self, rng: &mut impl Rng) -> Value {
        let between = |rng: &mut dyn rand::RngCore, low: f64, high: f64| {
            low + (high - low) * rng.random::<f64>()
        };
        match self {
            Self::Uniform([low, high]) => Value::Float(between(rng, *low, *high)),
            Self::LogUniform([low, high]) => {
                Value::Float(between(rng, low.ln(), high.ln()).exp().clamp(*low, *high))
            }
            Self::Normal([mean, deviation]) => {
                let drawn = Normal::new(*mean, *deviation).map(|normal| normal.sample(rng));
                Value::Float(drawn.unwrap_or(*mean))
            }
            Self::Choice(values) => values
                .get(rng.random_range(0..values.len()))
                .cloned()
                .unwrap_or(Value::Boolean(true)),
        }
    }
}

/// Sets a key in a table of tables by its dotted path.
fn insert(table: &mut Table, path: &str, value: &Value) -> anyhow::Result<()> {
    let Some((head, rest)) = path.split_once('.') else {
        table.insert(path.to_owned(), value.clone());
        return Ok(());
    };
    let inner = table.entry(head).or_insert_with(|| Value::Table(Table::new()));
    insert(inner.as_table_mut().with_context(|| format!("{head} is no table"))?, rest, value)
}

/// Leaves of a table of tables by their dotted paths.
fn dotted(prefix: &str, table: &Table) -> BTreeMap<String, Value> {
    let mut found = BTreeMap::new();
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
    use std::collections::BTreeSet;

    use super::*;

    fn parse(text: &str) -> anyhow::Result<Manifest> {
        Manifest::parse(&format!("schema_version = 1\n{text}"), PathBuf::new())
    }

    #[test]
    fn points_are_every_combination_once() -> anyhow::Result<()> {
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
            let inputs = manifest.inputs(point)?;
            let wind = inputs.effects.value(vehicle::effects::EffectId::Wind, "north_m_s", 0);
            let thrust = inputs.settings["control.thrust"].as_float();
            // Of the list, row by row.
            assert!([(Some(1.0), Some(0.2)), (Some(2.0), Some(0.3))].contains(&(wind, thrust)));
        }
        Ok(())
    }

    #[test]
    fn a_draw_is_the_same_for_each_seed_and_another_for_each_sample() -> anyhow::Result<()> {
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
    fn what_cannot_be_swept_is_refused_by_name() {
        let refused = |text: &str| format!("{:#}", parse(text).expect_err("refused"));
        assert!(refused("[grid]\nspeed = [1]\n").contains("\"speed\": expected vehicle"));
        assert!(refused("[grid]\nvehicle = ['a']\n[list]\nvehicle = ['b']").contains("two ways"));
        assert!(refused("[list]\nvehicle = ['b']\n'set.a' = [1, 2]").contains("as many"));
        assert!(refused("samples = 3").contains("nothing is drawn"));
        assert!(refused("seeds = 0").contains("found 0"));
        assert!(refused("seeds = 100000000").contains("10000000 points"));
        assert!(refused("[draw]\n'set.a' = { uniform = [2, 1] }").contains("in their order"));
        assert!(
            refused("[grid]\n'set.a' = { from = 0, to = 1, count = 2, log = true }")
                .contains("log")
        );
        assert!(refused("speed = 1").contains("speed"));
    }

    #[test]
    fn the_hash_is_of_the_files_too() -> anyhow::Result<()> {
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

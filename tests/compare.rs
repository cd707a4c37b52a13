//! Flights side by side: a known difference is reported with its interval, and chance alone counts
//! as a difference one time in twenty.

use std::fs;
use std::path::{Path, PathBuf};

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use downwash::cli::CompareArgs;
use downwash::command::{Compared, Inputs, Simulation, compared, entry};
use downwash::exam::interval::Rate;
use downwash::report::side_by_side::{Alignment, Comparison, Entry, Outcome, Pairing};
use vehicle::effects::EffectSet;

/// The shortest flight with a trajectory in it.
const TRAJECTORY: &str = "family = \"sinusoid-xy\"\naltitude_m = 0.6\nduration_s = 3.0\namplitude_m = [0.3, 0.2]\nperiod_s = [1.5, 1.5]\n";

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("compare").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

/// Flights of a vehicle with this effect, from these seeds.
fn flights(folder: &Path, effect: Option<&str>, seeds: std::ops::Range<u64>) -> Vec<Entry> {
    fs::create_dir_all(folder).unwrap();
    let trajectory = folder.join("short.toml");
    fs::write(&trajectory, TRAJECTORY).unwrap();
    seeds
        .map(|seed| {
            let mut effects = EffectSet::new();
            if let Some(effect) = effect {
                effects.insert_argument(effect).unwrap();
            }
            let inputs =
                Inputs { trajectory: Some(trajectory.clone()), effects, seed, ..Inputs::default() };
            let own = folder.join(seed.to_string());
            let (row, _) = Simulation::load(&inputs).unwrap().fly_logged(&own, |_| {}).unwrap();
            let flown = entry(&row.log.unwrap(), None).unwrap();
            // Logs are large, and the comparison has read what it needs.
            fs::remove_dir_all(&own).unwrap();
            flown
        })
        .collect()
}

fn compare(a: &[&Entry], b: &[&Entry], pairing: Pairing) -> Comparison {
    Comparison::new(a, b, Alignment::Time, pairing)
}

fn all(entries: &[Entry]) -> Vec<&Entry> {
    entries.iter().collect()
}

#[test]
fn known_effect_is_reported_with_interval_and_setting() {
    let folder = folder("known");
    let a = flights(&folder.join("a"), None, 0..4);
    let b = flights(&folder.join("b"), Some("mass:mass_kg=0.032"), 0..4);
    let compared = compare(&all(&a), &all(&b), Pairing::Auto);
    assert_eq!(compared.paired_by, Some("trajectory and seed"));
    assert_eq!(compared.outcome, Outcome::Worse, "{}", compared.sentence);
    let first = &compared.differences[0];
    let tested = first.tested.unwrap();
    assert_eq!(first.metric, "position error, 3D, RMS");
    assert!(tested.interval[0] > 0.0 && tested.interval[1] < 10.0 * tested.difference);
    assert!(compared.facts.iter().any(|fact| fact.key == "effects" && !fact.varies_within));
    // Compared the other way round it is better, by as much.
    let back = compare(&all(&b), &all(&a), Pairing::Auto);
    assert_eq!(back.outcome, Outcome::Better);
    assert!((back.differences[0].tested.unwrap().difference + tested.difference).abs() < 1e-12);
}

#[test]
fn identical_flights_do_not_differ() {
    let a = flights(&folder("same"), None, 0..3);
    for pairing in [Pairing::Auto, Pairing::None] {
        let compared = compare(&all(&a), &all(&a), pairing);
        assert_eq!(compared.outcome, Outcome::NoDifference, "{}", compared.sentence);
        assert!(compared.facts.is_empty());
    }
}

#[test]
fn logs_of_one_name_are_told_apart() {
    let folder = folder("names");
    let trajectory = folder.join("short.toml");
    fs::write(&trajectory, TRAJECTORY).unwrap();
    let [first, second] = ["first", "second"].map(|side| {
        let own = folder.join(side);
        let inputs = Inputs { trajectory: Some(trajectory.clone()), ..Inputs::default() };
        let (row, _) = Simulation::load(&inputs).unwrap().fly_logged(&own, |_| {}).unwrap();
        let log = own.join("flight.mcap");
        fs::rename(row.log.unwrap(), &log).unwrap();
        log
    });
    let args = CompareArgs::new(vec![first.clone()], vec![second.clone()]);
    let Compared { comparison, html } = compared(&args).unwrap();
    assert_eq!(
        [comparison.a, comparison.b].concat(),
        [first, second].map(|log| log.display().to_string())
    );
    assert!(html.contains("first/flight.mcap") && html.contains("second/flight.mcap"));
    assert!(
        !html.contains(&*folder.to_string_lossy()),
        "a page shows no more of a path than it needs"
    );
}

/// Forty-eight flights that differ only by their seeds, split at random again and again.
#[test]
#[ignore = "long: tests/run --all"]
fn chance_alone_is_significant_one_time_in_twenty() {
    const SPLITS: usize = 400;
    let folder = folder("chance");
    let pool = flights(&folder.join("a"), None, 0..48);
    let other = flights(&folder.join("b"), Some("rotor_drag:d_xy=0.004,d_z=0.002"), 100..148);
    let mean = |entries: &[Entry]| {
        let compared = compare(&all(entries), &all(entries), Pairing::None);
        compared.differences[0].a.mean
    };
    let truth = mean(&other) - mean(&pool);
    let mut random = Pcg64::seed_from_u64(7);
    for (size, pairing) in
        [(3, Pairing::None), (6, Pairing::None), (12, Pairing::None), (6, Pairing::Order)]
    {
        let (mut alarms, mut found, mut covered) = (0, 0, 0);
        for _ in 0..SPLITS {
            let (mut from, mut to) = (all(&pool), all(&other));
            from.shuffle(&mut random);
            to.shuffle(&mut random);
            let (a, b) = (&from[..size], &from[size..2 * size]);
            alarms += usize::from(compare(a, b, pairing).outcome != Outcome::NoDifference);
            let known = compare(a, &to[..size], pairing);
            let [low, high] = known.differences[0].tested.unwrap().interval;
            covered += usize::from(low <= truth && truth <= high);
            found += usize::from(known.outcome != Outcome::NoDifference);
        }
        // Wilson's interval assumes independent splits, which is nearly true for splits of one
        // pool.
        let [least, most] = Rate::new(alarms, SPLITS).interval;
        let share = |count: usize| count as f64 / SPLITS as f64;
        let [alarms, found, covered] = [alarms, found, covered].map(share);
        println!(
            "{size} flights, {pairing:?}: false alarms {alarms} [{least:.3}, {most:.3}], found {found}, \
             covered {covered}"
        );
        assert!(least <= 0.05, "{size} flights, {pairing:?}: at least {least} false alarms");
        assert!((0.015..=0.085).contains(&alarms), "{size} flights, {pairing:?}: {alarms}");
        assert!(covered >= 0.92, "{size} flights, {pairing:?}: {covered}");
        assert!(size < 6 || found > 0.9, "{size} flights, {pairing:?}: {found}");
    }
}

//! Training, validation and test rows: by whole flights, or by blocks if flights are few, never by
//! shuffled samples.

use std::ops::Range;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ROW_RATE_HZ;

/// The purpose of rows.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// For fitting the weights.
    Training,
    /// For selecting settings and the pass to stop at.
    Validation,
    /// Held out: for evaluation only.
    Test,
}

impl Part {
    /// All, in order.
    pub const ALL: [Part; 3] = [Part::Training, Part::Validation, Part::Test];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Part::Training => "training",
            Part::Validation => "validation",
            Part::Test => "test",
        }
    }

    /// Its fraction of the rows (Bansal et al. 2016, section V-B).
    fn share(self) -> f64 {
        match self {
            Part::Training => 0.60,
            Part::Validation => 0.25,
            Part::Test => 0.15,
        }
    }
}

/// Below this number of flights, each is cut into blocks.
const WHOLE_FLIGHTS_MIN: usize = 5;
/// Largest distance of flights that may be swapped: they are then of one kind.
const NEIGHBOURS: usize = 8;
/// Most sweeps over all pairs of neighbours.
const SWEEPS_MAX: usize = 20;
/// Penalty on a part's number of rows: an error of a tenth of its share counts as much as one trait
/// that is off by a standard deviation.
const SHARE_WEIGHT: f64 = 100.0;
/// Rows left out between blocks: windows and the vehicle's dynamics extend across a border.
const BORDER_ROWS: usize = 100;
/// The same, s.
pub(super) const BORDER_S: f64 = BORDER_ROWS as f64 / ROW_RATE_HZ;
/// With whole flights, a part has at least this fraction of its share of the rows.
const OF_SHARE_MIN: f64 = 0.5;

/// How rows were split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SplitKind {
    /// Every flight is in one part.
    WholeFlights,
    /// Every flight is cut into one block for each part.
    Blocks,
}

/// Ranges of each flight's rows, with their purpose.
#[derive(Clone, Debug, PartialEq)]
pub struct Split {
    /// The kind of split.
    pub kind: SplitKind,
    /// Ranges for each flight.
    pub flights: Vec<Vec<(Range<usize>, Part)>>,
}

/// Traits of a flight that the parts of a split should share: its number of rows, and how it was
/// flown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traits {
    /// Number of rows.
    pub rows: usize,
    /// Root mean squares of horizontal and vertical speed, m/s.
    pub speeds_m_s: [f64; 2],
    /// Root mean squares of tilting and yawing rate, rad/s.
    pub rates_rad_s: [f64; 2],
    /// Mean voltage, V; 0 where it is not logged.
    pub voltage_v: f64,
}

impl Split {
    /// Splits flights. Flights of one kind should be consecutive: each goes to the part with the
    /// largest deficit, so that every kind appears in every part. Neighbours are then swapped as
    /// long as this makes the parts more alike in how they were flown: a part with all the full
    /// packs, or all the fast flights, would be a different task. If a part gets too few rows,
    /// because one flight is far longer than the others, each flight is cut into blocks instead.
    pub fn of(flights: &[Traits]) -> Self {
        let by_blocks = || Self {
            kind: SplitKind::Blocks,
            flights: flights.iter().map(|flight| blocks(flight.rows)).collect(),
        };
        if flights.len() < WHOLE_FLIGHTS_MIN {
            return by_blocks();
        }
        let mut parts = in_turn(flights);
        balance(flights, &mut parts);
        if !is_shared(flights, &parts) {
            return by_blocks();
        }
        let flights = flights.iter().zip(parts).map(|(f, part)| vec![(0..f.rows, part)]).collect();
        Self { kind: SplitKind::WholeFlights, flights }
    }
}

/// Whether every part has approximately its share of the rows.
fn is_shared(flights: &[Traits], parts: &[Part]) -> bool {
    let (mut total, mut have) = (0.0, [0.0; 3]);
    for (flight, part) in flights.iter().zip(parts) {
        total += flight.rows as f64;
        have[*part as usize] += flight.rows as f64;
    }
    Part::ALL.iter().all(|part| have[*part as usize] >= OF_SHARE_MIN * part.share() * total)
}

/// Assigns each flight to the part with the largest deficit.
fn in_turn(flights: &[Traits]) -> Vec<Part> {
    let (mut total, mut have) = (0.0, [0.0; 3]);
    flights
        .iter()
        .map(|flight| {
            total += flight.rows as f64;
            let lack = |part: &Part| part.share() * total - have[*part as usize];
            let part = Part::ALL
                .into_iter()
                .max_by(|a, b| lack(a).total_cmp(&lack(b)).then(b.cmp(a)))
                .unwrap_or(Part::Training);
            have[part as usize] += flight.rows as f64;
            part
        })
        .collect()
}

/// Number of moments: means and mean squares of the traits.
const MOMENTS: usize = 10;

/// Swaps neighbours until no swap makes the parts more alike.
fn balance(flights: &[Traits], parts: &mut [Part]) {
    let moments = moments(flights);
    let mut sums = Sums::default();
    for ((flight, moments), part) in flights.iter().zip(&moments).zip(&*parts) {
        sums.add(*part, flight.rows as f64, moments);
    }
    let mut least = sums.imbalance();
    for _ in 0..SWEEPS_MAX {
        let before = least;
        for i in 0..flights.len() {
            for j in i + 1..(i + NEIGHBOURS).min(flights.len()) {
                if parts[i] == parts[j] {
                    continue;
                }
                let mut swapped = sums;
                for (from, to) in [(i, j), (j, i)] {
                    let rows = flights[from].rows as f64;
                    swapped.add(parts[from], -rows, &moments[from]);
                    swapped.add(parts[to], rows, &moments[from]);
                }
                let imbalance = swapped.imbalance();
                if imbalance < least - 1e-9 {
                    (sums, least) = (swapped, imbalance);
                    parts.swap(i, j);
                }
            }
        }
        if least == before {
            break;
        }
    }
}

/// Each flight's traits, and their squares, standardised over all flights to mean 0 and deviation
/// 1.
fn moments(flights: &[Traits]) -> Vec<[f64; MOMENTS]> {
    let mut moments: Vec<[f64; MOMENTS]> = flights
        .iter()
        .map(|flight| {
            let ([a, b], [c, d]) = (flight.speeds_m_s, flight.rates_rad_s);
            let mut moments = [0.0; MOMENTS];
            moments[..MOMENTS / 2].copy_from_slice(&[a, b, c, d, flight.voltage_v]);
            moments
        })
        .collect();
    for trait_of in 0..MOMENTS / 2 {
        let square = trait_of + MOMENTS / 2;
        standardise(&mut moments, trait_of);
        for moments in &mut moments {
            moments[square] = moments[trait_of].powi(2);
        }
        standardise(&mut moments, square);
    }
    moments
}

/// Scales a column to mean 0 and deviation 1; a constant column becomes 0.
fn standardise(rows: &mut [[f64; MOMENTS]], column: usize) {
    let count = rows.len() as f64;
    let mean = rows.iter().map(|row| row[column]).sum::<f64>() / count;
    let variance = rows.iter().map(|row| (row[column] - mean).powi(2)).sum::<f64>() / count;
    let scale = if variance > 1e-18 { 1.0 / variance.sqrt() } else { 0.0 };
    for row in rows {
        row[column] = (row[column] - mean) * scale;
    }
}

/// Sums over the flights of each part, weighted by rows.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    rows: [f64; 3],
    flights: [f64; 3],
    moments: [[f64; MOMENTS]; 3],
}

impl Sums {
    /// Adds a flight with `rows` rows; negative rows remove it.
    fn add(&mut self, part: Part, rows: f64, moments: &[f64; MOMENTS]) {
        let part = part as usize;
        self.rows[part] += rows;
        self.flights[part] += rows.signum();
        for (sum, moment) in self.moments[part].iter_mut().zip(moments) {
            *sum += rows * moment;
        }
    }

    /// Distance of the parts from equal moments and from their shares: in randomly drawn parts,
    /// every moment contributes about one.
    fn imbalance(&self) -> f64 {
        let total: f64 = self.rows.iter().sum();
        Part::ALL
            .into_iter()
            .map(|part| {
                let (share, part) = (part.share(), part as usize);
                let rows = self.rows[part].max(1.0);
                let unlike = self.moments[part].iter().map(|sum| (sum / rows).powi(2)).sum::<f64>();
                let off = self.rows[part] / total / share - 1.0;
                self.flights[part] * unlike + SHARE_WEIGHT * off.powi(2)
            })
            .sum()
    }
}

/// One flight's blocks, in time order.
fn blocks(count: usize) -> Vec<(Range<usize>, Part)> {
    let usable = count.saturating_sub(2 * BORDER_ROWS) as f64;
    let mut start = 0;
    let mut blocks = Vec::new();
    for part in Part::ALL {
        let length = (usable * part.share()).floor() as usize;
        blocks.push((start..(start + length).min(count), part));
        start += length + BORDER_ROWS;
    }
    blocks.retain(|(range, _)| range.start < range.end);
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn flight(rows: usize) -> Traits {
        Traits { rows, ..Traits::default() }
    }

    fn shares(split: &Split) -> [f64; 3] {
        let mut have = [0.0; 3];
        for (range, part) in split.flights.iter().flatten() {
            have[*part as usize] += range.len() as f64;
        }
        let total: f64 = have.iter().sum();
        have.map(|rows| rows / total)
    }

    #[test]
    fn many_flights_split_in_the_papers_proportions() {
        let [training, validation, test] = shares(&Split::of(&[flight(6000); 40]));
        assert!((training - 0.60).abs() < 0.03);
        assert!((validation - 0.25).abs() < 0.03);
        assert!((test - 0.15).abs() < 0.03);
    }

    #[test]
    fn every_part_contains_every_kind_of_flight() {
        let split = Split::of(&[flight(6000); 40]);
        for kind in split.flights.chunks(8) {
            for part in Part::ALL {
                assert!(kind.iter().flatten().any(|(_, p)| *p == part), "{part:?}");
            }
        }
    }

    #[test]
    fn one_long_flight_among_short_ones_leaves_no_part_empty() {
        let flights = [60_000, 700, 650, 600, 500].map(flight);
        let split = Split::of(&flights);
        assert_eq!(split.kind, SplitKind::Blocks);
        for (share, part) in shares(&split).into_iter().zip(Part::ALL) {
            assert!((share - part.share()).abs() < 0.05, "{part:?} {share}");
        }
        assert_eq!(Split::of(&[flight(6000); 5]).kind, SplitKind::WholeFlights);
    }

    /// Packs that are swapped in a cycle keep step with the parts' turns.
    #[test]
    fn cyclic_battery_packs_are_spread_over_all_parts() {
        let packs = [12.6, 11.4, 12.0, 10.8];
        let flights: Vec<Traits> =
            (0..40).map(|i| Traits { voltage_v: packs[i % 4], ..flight(6000) }).collect();
        let split = Split::of(&flights);
        for part in Part::ALL {
            let of_part = split.flights.iter().zip(&flights).filter(|(f, _)| f[0].1 == part);
            let packs: Vec<f64> = of_part.map(|(_, flight)| flight.voltage_v).collect();
            let mean = packs.iter().sum::<f64>() / packs.len() as f64;
            let square = packs.iter().map(|pack| (pack - mean).powi(2)).sum::<f64>();
            let deviation = (square / packs.len() as f64).sqrt();
            assert!((mean - 11.7).abs() < 0.15 && (deviation - 0.67).abs() < 0.15, "{packs:?}");
        }
        assert_eq!(shares(&split), shares(&Split::of(&[flight(6000); 40])));
    }

    proptest! {
        #[test]
        fn every_split_is_close_to_its_shares(
            flown in prop::collection::vec((3000usize..9000, 0.0..3.0_f64, 0.0..2.0_f64), 20..60),
        ) {
            let flights: Vec<Traits> = flown
                .into_iter()
                .map(|(rows, speed, rate)| Traits {
                    rows,
                    speeds_m_s: [speed, 0.3 * speed],
                    rates_rad_s: [rate, 0.1],
                    voltage_v: 12.0,
                })
                .collect();
            for (share, part) in shares(&Split::of(&flights)).into_iter().zip(Part::ALL) {
                prop_assert!((share - part.share()).abs() < 0.1, "{part:?} {share}");
            }
        }

        #[test]
        fn blocks_of_one_flight_are_separated(count in 0usize..20_000) {
            let split = Split::of(&[flight(count)]);
            let ranges = &split.flights[0];
            for pair in ranges.windows(2) {
                prop_assert!(pair[0].0.end + BORDER_ROWS <= pair[1].0.start);
            }
            prop_assert!(ranges.iter().all(|(range, _)| range.end <= count));
        }
    }
}

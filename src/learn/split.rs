//! Training, validation and test rows: by whole flights, or by blocks where flights are few, never
//! by shuffled samples.

use std::ops::Range;

use serde::{Deserialize, Serialize};

/// What rows are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// Weights are fitted on them.
    Training,
    /// Settings and the pass to stop at are chosen on them.
    Validation,
    /// Only judged on.
    Test,
}

impl Part {
    /// All, in order.
    pub const ALL: [Part; 3] = [Part::Training, Part::Validation, Part::Test];

    /// Its share of the rows (Bansal et al. 2016, section V-A).
    fn share(self) -> f64 {
        match self {
            Part::Training => 0.60,
            Part::Validation => 0.25,
            Part::Test => 0.15,
        }
    }
}

/// Flights below which each is cut into blocks.
const WHOLE_FLIGHTS_MIN: usize = 5;
/// Rows left out between blocks: windows and the vehicle's memory reach across a border.
const BORDER_ROWS: usize = 100;

/// How rows were split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SplitKind {
    /// Every flight is in one part.
    WholeFlights,
    /// Every flight is cut into one block for each part.
    Blocks,
}

/// Ranges of each flight's rows, with what they are for.
#[derive(Clone, Debug, PartialEq)]
pub struct Split {
    /// How.
    pub kind: SplitKind,
    /// For each flight.
    pub flights: Vec<Vec<(Range<usize>, Part)>>,
}

impl Split {
    /// Splits flights of these numbers of rows. Flights of one kind should follow one another:
    /// each goes to the part that lacks most, so that every kind comes into every part.
    pub fn of(rows: &[usize]) -> Self {
        if rows.len() < WHOLE_FLIGHTS_MIN {
            let flights = rows.iter().map(|count| blocks(*count)).collect();
            return Self { kind: SplitKind::Blocks, flights };
        }
        let (mut total, mut have) = (0.0, [0.0; 3]);
        let flights = rows
            .iter()
            .map(|count| {
                total += *count as f64;
                let lack = |part: &Part| part.share() * total - have[*part as usize];
                let part = Part::ALL
                    .into_iter()
                    .max_by(|a, b| lack(a).total_cmp(&lack(b)).then(b.cmp(a)))
                    .unwrap_or(Part::Training);
                have[part as usize] += *count as f64;
                vec![(0..*count, part)]
            })
            .collect();
        Self { kind: SplitKind::WholeFlights, flights }
    }
}

/// One flight's blocks, in the order of time.
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

    fn shares(split: &Split) -> [f64; 3] {
        let mut have = [0.0; 3];
        for (range, part) in split.flights.iter().flatten() {
            have[*part as usize] += range.len() as f64;
        }
        let total: f64 = have.iter().sum();
        have.map(|rows| rows / total)
    }

    #[test]
    fn many_flights_are_shared_as_the_paper_does() {
        let [training, validation, test] = shares(&Split::of(&[6000; 40]));
        assert!((training - 0.60).abs() < 0.03);
        assert!((validation - 0.25).abs() < 0.03);
        assert!((test - 0.15).abs() < 0.03);
    }

    #[test]
    fn every_kind_of_flight_comes_into_every_part() {
        let split = Split::of(&[6000; 40]);
        for kind in split.flights.chunks(8) {
            for part in Part::ALL {
                assert!(kind.iter().flatten().any(|(_, p)| *p == part), "{part:?}");
            }
        }
    }

    proptest! {
        #[test]
        fn blocks_of_one_flight_do_not_touch(count in 0usize..20_000) {
            let split = Split::of(&[count]);
            let ranges = &split.flights[0];
            for pair in ranges.windows(2) {
                prop_assert!(pair[0].0.end + BORDER_ROWS <= pair[1].0.start);
            }
            prop_assert!(ranges.iter().all(|(range, _)| range.end <= count));
        }
    }
}

//! The boots of the vehicle in one on-board log, and the choice of one of them.

use super::{NEIGHBOURS, Row, Topic, Topics, middle};
use crate::import::LogFault;
use crate::import::boot::Boot;
use crate::import::tally::Tally;

/// A clock that falls back by more than this was restarted, s.
const RESTART: f64 = 1.0;
/// Number of rows on each side whose medians must agree on a restart.
const RESTART_ROWS: usize = 50;
/// Fewest rows of a boot.
const BOOT_ROWS: usize = 10;

/// Where the boots of a file begin, and the chosen one.
#[derive(Clone, Debug, Default)]
pub(in crate::import) struct Boots {
    /// For all but the first boot: the index of its first row, and the stamps of the row before and
    /// of this row, s.
    starts: Vec<(usize, [f64; 2])>,
    /// Index of the chosen boot.
    pub chosen: usize,
}

impl Boots {
    /// Number of boots.
    pub fn count(&self) -> usize {
        self.starts.len() + 1
    }

    /// The boot of something that was logged before the row of this index, with a stamp in s if it
    /// has one. Between the rows of two boots, it is of the nearer one, and without a stamp of the
    /// second, as a log begins with what it states about the vehicle.
    pub fn of(&self, row: usize, stamp: Option<f64>) -> usize {
        let boot = self.starts.partition_point(|(start, _)| *start <= row);
        let between = boot.checked_sub(1).and_then(|before| self.starts.get(before));
        match (between, stamp) {
            (Some((start, [last, first])), Some(stamp))
                if *start == row && (stamp - last).abs() < (stamp - first).abs() =>
            {
                boot - 1
            }
            _ => boot,
        }
    }
}

impl Topics {
    /// The rows of each boot of the vehicle; `starts` are the indices of all but the first boot's
    /// first rows.
    fn boots(self, starts: &[usize]) -> Vec<Self> {
        let mut boots = Vec::with_capacity(starts.len() + 1);
        let ends = starts.iter().copied().chain([self.clock.len()]);
        let mut from = 0;
        for to in ends {
            let clock = self.clock[from..to].to_vec();
            boots.push(Self { clock, ..Self::default() });
            from = to;
        }
        for (key, topic) in self.topics {
            for (row, number) in topic.values.chunks_exact(topic.fields.len()).zip(topic.numbers) {
                let number = number as usize;
                let boot = starts.partition_point(|start| *start <= number);
                let first = boot.checked_sub(1).map_or(0, |before| starts[before]);
                let fresh = || Topic::bare(topic.name, topic.fields);
                let kept = boots[boot].topics.entry(key).or_insert_with(fresh);
                kept.values.extend_from_slice(row);
                kept.numbers.push((number - first) as u32);
            }
        }
        boots
    }

    /// Indices of the rows before which the vehicle's clock starts anew.
    fn restarts(&self) -> Vec<usize> {
        let mut starts = Vec::new();
        let mut last = 0;
        for at in BOOT_ROWS..self.clock.len().saturating_sub(BOOT_ROWS - 1) {
            let falls = self.clock[at] < self.clock[at - 1] - RESTART;
            if !falls || at < last + BOOT_ROWS {
                continue;
            }
            let before = middle(&self.clock[at.saturating_sub(RESTART_ROWS).max(last)..at]);
            let after = middle(&self.clock[at..self.clock.len().min(at + RESTART_ROWS)]);
            if before.zip(after).is_some_and(|(before, after)| after < before - RESTART) {
                starts.push(at);
                last = at;
            }
        }
        starts
    }

    /// The chosen boot of several in one file, counted from 1; by default the one that flew
    /// longest according to `flown`, s, or lasted longest. Notes all boots and counts the rows of
    /// the others.
    ///
    /// # Errors
    /// The file does not have the chosen boot.
    pub fn choose_boot(
        self,
        boot: Option<usize>,
        flown: impl Fn(&Self) -> f64,
        notes: &mut Vec<String>,
        tally: &mut Tally,
    ) -> Result<Self, LogFault> {
        let starts = self.restarts();
        let ends = |start: &usize| (*start, [self.clock[*start - 1], self.clock[*start]]);
        let ends = starts.iter().map(ends).collect();
        if boot.is_none_or(|boot| boot == 1) && starts.is_empty() {
            return Ok(self);
        }
        let mut boots = self.boots(&starts);
        let count = boots.len();
        if let Some(boot) = boot.filter(|boot| !(1..=count).contains(boot)) {
            return Err(LogFault::NoBoot { boot, boots: count });
        }
        let known: Vec<Boot> =
            boots.iter().map(|boot| Boot { span: boot.span(), flown: flown(boot) }).collect();
        let weight = |at: usize| {
            let Boot { span: [from, to], flown } = known[at];
            (flown as u64, (to - from) as u64)
        };
        let longest = (0..count).rev().max_by_key(|at| weight(*at)).unwrap_or(0);
        let chosen = boot.map_or(longest, |boot| boot - 1);
        notes.extend(Boot::notes(&known, chosen));
        for (_, boot) in boots.iter().enumerate().filter(|(at, _)| *at != chosen) {
            tally.add("row of another boot of the vehicle", boot.clock.len() as u64);
        }
        let mut kept = boots.swap_remove(chosen);
        kept.boots = Boots { starts: ends, chosen };
        Ok(kept)
    }

    /// First and last time of the clock, s; medians, which a few damaged stamps do not change.
    fn span(&self) -> [f64; 2] {
        let ends = self.clock.len().min(NEIGHBOURS);
        let first = middle(&self.clock[..ends]).unwrap_or_default();
        let last = middle(&self.clock[self.clock.len() - ends..]).unwrap_or_default();
        [first, last]
    }

    /// Time in the air according to the rows of a topic, s. `in_air` returns a row's time and
    /// state, or `None` if the row does not state it.
    pub fn time_in_air(
        &self,
        topic: &'static str,
        in_air: impl Fn(Row<'_>) -> Option<(f64, bool)>,
    ) -> f64 {
        let Some((_, topic)) = self.instances(topic).next() else { return 0.0 };
        let (mut flown, mut since) = (0.0, None);
        let end = self.span()[1];
        let ends = [(end, false)];
        for (time, flies) in topic.rows().filter_map(in_air).chain(ends) {
            flown += since.map_or(0.0, |since: f64| (time - since).max(0.0));
            since = (flies && time.is_finite()).then_some(time);
        }
        flown
    }
}

#[cfg(test)]
mod tests {
    use super::super::TopicSpec;
    use super::*;

    const SPEC: TopicSpec = TopicSpec { topic: "topic", fields: &["x"] };

    fn rows(stamps: impl IntoIterator<Item = f64>) -> Topics {
        let mut topics = Topics::default();
        stamps.into_iter().for_each(|stamp| topics.push(SPEC, 0, stamp, &[stamp]));
        topics
    }

    #[test]
    fn boots_are_parted_where_the_clock_starts_anew() {
        let boot = |from: f64, count: u32| (0..count).map(move |k| from + 0.1 * f64::from(k));
        // The second starts within the time of the first.
        let log = || rows(boot(5.0, 200).chain(boot(12.0, 300)));
        assert_eq!(log().restarts(), [200]);
        let choose = |boot| {
            let (mut notes, mut tally) = (Vec::new(), Tally::default());
            let chosen = log().choose_boot(boot, |_| 0.0, &mut notes, &mut tally);
            chosen.map(|chosen| (chosen.clock, notes, tally.into_vec()))
        };
        let Ok((clock, notes, left_out)) = choose(None) else { panic!("the longest") };
        assert_eq!(clock, boot(12.0, 300).collect::<Vec<_>>());
        assert!(notes[1].contains("boot 2 of 2") && notes[1].ends_with("used"), "{notes:?}");
        assert_eq!(left_out[0].1, 200);
        let Ok((clock, ..)) = choose(Some(1)) else { panic!("the first") };
        assert_eq!(clock, boot(5.0, 200).collect::<Vec<_>>());
        assert!(matches!(choose(Some(3)), Err(LogFault::NoBoot { boot: 3, boots: 2 })));
    }

    #[test]
    fn statements_between_two_boots_are_of_the_nearer_one() {
        let boots = Boots { starts: vec![(200, [24.9, 12.0])], chosen: 0 };
        for (row, stamp, boot) in [
            (0, None, 0),
            (199, Some(12.0), 0),
            (200, Some(24.8), 0),
            (200, Some(0.1), 1),
            (200, Some(f64::NAN), 1),
            (200, None, 1),
            (201, Some(24.8), 1),
        ] {
            assert_eq!(boots.of(row, stamp), boot, "{row} {stamp:?}");
        }
    }

    #[test]
    fn damaged_stamps_and_late_rows_are_no_boots() {
        let mut stamps: Vec<f64> = (0..300).map(|k| 100.0 + 0.1 * f64::from(k)).collect();
        stamps[40] = 1e9;
        stamps[90] = 3.0;
        stamps[91] = 3.1;
        stamps[150] = f64::NAN;
        // A logger first writes what it has last seen of rare topics.
        let late = [7.0, 90.0, 2.0].into_iter();
        assert_eq!(rows(late.chain(stamps)).restarts(), [0; 0]);
    }

    #[test]
    fn time_in_air_is_counted_to_the_end() {
        let log = rows((0..100).map(f64::from));
        let state = |row: Row<'_>| {
            let time = row.get("x");
            [10.0, 40.0, 80.0].contains(&time).then_some((time, time != 40.0))
        };
        assert!((log.time_in_air("topic", state) - 42.0).abs() < 1e-9);
    }
}

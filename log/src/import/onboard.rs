//! Rows of an autopilot's on-board log: topics of named numbers, each row with a time stamp on the
//! vehicle's clock.
//!
//! Neither format has a checksum, so any number may be damaged. A damaged time stamp must not
//! discard everything after it: rows are first compared with the clock of their neighbours in the
//! file, and then the longest increasing sequence is kept.

mod boots;

use std::collections::BTreeMap;

use super::flight::Stream;
use super::tally::Tally;
pub(super) use boots::Boots;

/// Number of neighbours on each side in the file that determine the clock.
const NEIGHBOURS: usize = 15;
/// A time stamp further than this from the clock on both sides is damaged, s.
const OFF_CLOCK: f64 = 10.0;
/// A topic to read and the fields of its rows.
#[derive(Clone, Copy, Debug)]
pub(super) struct TopicSpec {
    pub topic: &'static str,
    pub fields: &'static [&'static str],
}

/// A row of a topic; fields that the log lacks are NaN.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<'a> {
    fields: &'static [&'static str],
    values: &'a [f64],
}

impl Row<'_> {
    pub fn get(&self, field: &str) -> f64 {
        let at = self.fields.iter().position(|known| *known == field);
        at.and_then(|at| self.values.get(at)).copied().unwrap_or(f64::NAN)
    }

    pub fn all<const N: usize>(&self, fields: [&str; N]) -> [f64; N] {
        fields.map(|field| self.get(field))
    }

    /// As [`Row::all`]; `None` unless all are finite.
    pub fn finite<const N: usize>(&self, fields: [&str; N]) -> Option<[f64; N]> {
        let values = self.all(fields);
        values.iter().all(|value| value.is_finite()).then_some(values)
    }
}

/// Rows of one topic and instance, in the order of the file.
#[derive(Clone, Debug)]
pub(super) struct Topic {
    name: &'static str,
    fields: &'static [&'static str],
    values: Vec<f64>,
    /// Index of each row among all rows of the file.
    numbers: Vec<u32>,
}

impl Topic {
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// A topic without rows.
    fn bare(name: &'static str, fields: &'static [&'static str]) -> Self {
        Self { name, fields, values: Vec::new(), numbers: Vec::new() }
    }

    pub fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        let rows = self.values.chunks_exact(self.fields.len());
        rows.map(|values| Row { fields: self.fields, values })
    }

    /// Whether any row has a finite number in `field`.
    pub fn has(&self, field: &str) -> bool {
        self.rows().any(|row| row.get(field).is_finite())
    }

    /// The most frequent finite number in `field`.
    pub fn most_frequent(&self, field: &str) -> Option<f64> {
        let mut counts: BTreeMap<u64, usize> = BTreeMap::new();
        for value in self.rows().map(|row| row.get(field)).filter(|value| value.is_finite()) {
            *counts.entry(value.to_bits()).or_default() += 1;
        }
        counts.into_iter().max_by_key(|(_, count)| *count).map(|(bits, _)| f64::from_bits(bits))
    }
}

/// The result of converting a row.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Sample<T> {
    /// A sample with its time, s.
    Keep(f64, T),
    /// The row does not belong to this stream; nothing is lost.
    Skip,
    /// The row is dropped for this reason.
    Refuse(&'static str),
}

impl<T> Sample<T> {
    /// A sample if there is a value, else a refusal.
    pub fn of(time: f64, value: Option<T>) -> Self {
        match value {
            Some(value) => Self::Keep(time, value),
            None => Self::Refuse("not finite, or impossible"),
        }
    }
}

/// The topics of a log that are read.
#[derive(Clone, Debug, Default)]
pub(super) struct Topics {
    /// Time stamps of all rows in file order, s.
    clock: Vec<f64>,
    topics: BTreeMap<(&'static str, u8), Topic>,
    /// The boots of the file, after the choice of one.
    pub boots: Boots,
}

impl Topics {
    /// Adds a row of `spec`: its time stamp in s and its numbers.
    pub fn push(&mut self, spec: TopicSpec, instance: u8, time: f64, values: &[f64]) {
        let Ok(number) = u32::try_from(self.clock.len()) else { return };
        debug_assert_eq!(values.len(), spec.fields.len());
        self.clock.push(time);
        let fresh = || Topic::bare(spec.topic, spec.fields);
        let topic = self.topics.entry((spec.topic, instance)).or_insert_with(fresh);
        topic.values.extend_from_slice(values);
        topic.numbers.push(number);
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.clock.len()
    }

    /// Time stamp of the newest row, s; NaN without one.
    pub fn latest(&self) -> f64 {
        self.clock.last().copied().unwrap_or(f64::NAN)
    }

    /// One instance of a topic.
    pub fn instance(&self, name: &'static str, instance: u8) -> Option<&Topic> {
        self.topics.get(&(name, instance))
    }

    /// All instances of a topic.
    pub fn instances(&self, name: &'static str) -> impl Iterator<Item = (u8, &Topic)> {
        self.topics
            .range((name, 0)..=(name, u8::MAX))
            .map(|((_, instance), topic)| (*instance, topic))
    }

    /// The primary instance of a topic if it was logged, else the first.
    pub fn primary_instance(&self, name: &'static str, primary: u8) -> Option<u8> {
        let first = || self.instances(name).next().map(|(instance, _)| instance);
        self.instance(name, primary).map(|_| primary).or_else(first)
    }

    /// The first instance of a topic with a row that `is_live` accepts; 0 without one.
    pub fn first_live(&self, name: &'static str, is_live: impl Fn(Row<'_>) -> bool) -> u8 {
        let mut instances = self.instances(name);
        let live = instances.find(|(_, topic)| topic.rows().any(&is_live));
        live.map_or(0, |(instance, _)| instance)
    }

    /// The topic of [`Topics::primary_instance`]. Counts the rows of the others.
    pub fn primary(&self, name: &'static str, primary: u8, tally: &mut Tally) -> Option<&Topic> {
        let chosen = self.primary_instance(name, primary)?;
        let topic = self.instance(name, chosen)?;
        for (instance, topic) in self.instances(name).filter(|(instance, _)| *instance != chosen) {
            let reason = format!("{name}: of instance {instance}, where {chosen} is used");
            tally.add(&reason, topic.len() as u64);
        }
        Some(topic)
    }

    /// Converts a topic's rows to a stream.
    pub fn stream<T>(
        &self,
        topic: &Topic,
        tally: &mut Tally,
        mut sample: impl FnMut(Row<'_>) -> Sample<T>,
    ) -> Stream<T> {
        let mut samples = Vec::with_capacity(topic.len());
        let (mut refused, mut off) = (BTreeMap::new(), 0);
        for (row, number) in topic.rows().zip(&topic.numbers) {
            match sample(row) {
                Sample::Keep(time, value) if self.is_on_clock(*number, time) => {
                    samples.push((time, value));
                }
                Sample::Keep(..) => off += 1,
                Sample::Skip => {}
                Sample::Refuse(reason) => *refused.entry(reason).or_insert(0) += 1,
            }
        }
        let name = topic.name;
        tally.add(&format!("{name}: its stamp is off the log's clock"), off);
        for (reason, count) in refused {
            tally.add(&format!("{name}: {reason}"), count);
        }
        let (stream, unordered) = ordered(samples);
        tally.add(&format!("{name}: sent again or out of order"), unordered);
        stream
    }

    /// Whether a time fits the time stamps before or after it in the file.
    fn is_on_clock(&self, number: u32, time: f64) -> bool {
        let number = number as usize;
        let before = middle(&self.clock[number.saturating_sub(NEIGHBOURS)..number]);
        let after_end = self.clock.len().min(number + 1 + NEIGHBOURS);
        let after = middle(&self.clock[number + 1..after_end]);
        let fits = |stamp: Option<f64>| stamp.is_some_and(|stamp| (stamp - time).abs() < OFF_CLOCK);
        time.is_finite() && (fits(before) || fits(after) || (before, after) == (None, None))
    }
}

/// The median of the finite time stamps.
fn middle(stamps: &[f64]) -> Option<f64> {
    let mut stamps: Vec<f64> = stamps.iter().copied().filter(|t| t.is_finite()).collect();
    let at = stamps.len() / 2;
    let is_any = !stamps.is_empty();
    is_any.then(|| *stamps.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The longest sequence of samples with increasing times, and the number of samples outside it.
fn ordered<T>(samples: Vec<(f64, T)>) -> (Stream<T>, u64) {
    // For each sequence length, the sample that ends such a sequence earliest; and for each sample
    // its predecessor.
    let mut ends: Vec<usize> = Vec::new();
    let mut previous: Vec<Option<usize>> = Vec::with_capacity(samples.len());
    for (at, (time, _)) in samples.iter().enumerate() {
        let length = ends.partition_point(|end| samples[*end].0 < *time);
        previous.push(length.checked_sub(1).map(|before| ends[before]));
        match ends.get_mut(length) {
            Some(end) => *end = at,
            None => ends.push(at),
        }
    }
    let mut keep = vec![false; samples.len()];
    let mut next = ends.last().copied();
    while let Some(at) = next {
        keep[at] = true;
        next = previous[at];
    }
    let mut stream = Stream::default();
    let mut left_out = 0;
    for ((time, value), keep) in samples.into_iter().zip(keep) {
        if !(keep && stream.push(time, value)) {
            left_out += 1;
        }
    }
    (stream, left_out)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPEC: TopicSpec = TopicSpec { topic: "topic", fields: &["x"] };

    fn stream(stamps: &[f64]) -> (Vec<f64>, Vec<(String, u64)>) {
        let mut topics = Topics::default();
        for stamp in stamps {
            topics.push(SPEC, 0, *stamp, &[*stamp]);
        }
        let mut tally = Tally::default();
        let topic = topics.primary("topic", 0, &mut tally).expect("rows");
        let stream = topics.stream(topic, &mut tally, |row| {
            let x = row.get("x");
            Sample::of(x, x.is_finite().then_some(()))
        });
        (stream.times().to_vec(), tally.into_vec())
    }

    #[test]
    fn one_damaged_timestamp_drops_one_row() {
        let mut stamps: Vec<f64> = (0..50).map(f64::from).map(|k| 100.0 + 0.1 * k).collect();
        let sound = stamps.clone();
        for damaged in [1e9, -3.0, 104.9, f64::NAN] {
            stamps[20] = damaged;
            let (times, left_out) = stream(&stamps);
            assert_eq!(times.len(), 49, "{damaged}");
            assert_eq!(left_out.iter().map(|(_, count)| count).sum::<u64>(), 1);
            assert!(times.iter().all(|time| sound.contains(time)));
        }
        stamps = sound.clone();
        stamps[49] = 1e9;
        assert_eq!(stream(&stamps).0, sound[..49]);
    }

    #[test]
    fn logger_pause_is_not_taken_for_damage() {
        let stamps: Vec<f64> =
            (0..40).map(|k| f64::from(k) + if k < 20 { 0.0 } else { 600.0 }).collect();
        let (times, left_out) = stream(&stamps);
        assert_eq!((times, left_out), (stamps, vec![]));
    }

    #[test]
    fn rows_of_other_instances_are_counted() {
        let mut topics = Topics::default();
        for instance in [1, 2, 2] {
            topics.push(SPEC, instance, 0.0, &[0.0]);
        }
        let mut tally = Tally::default();
        assert_eq!(topics.primary("topic", 2, &mut tally).map(Topic::len), Some(2));
        assert_eq!(topics.primary("topic", 7, &mut tally).map(Topic::len), Some(1));
        assert_eq!(tally.into_vec().len(), 2);
    }
}

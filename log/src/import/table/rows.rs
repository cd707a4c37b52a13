//! The rows of a table on their way into a flight: sorted, without damaged times and repetitions.

use crate::import::flight::{AttitudeSetpoint, Flight, Stream};
use crate::import::mapping::Row;
use crate::import::tally::Tally;

/// Longest step to the next row that is neither a damaged time nor a pause, s.
const STEP_MAX_S: f64 = 10.0;
/// Number of first rows that show whether the rows are in order; only a table that is not is held
/// in memory as rows.
const FIRST_ROWS: usize = 1000;

/// Rows on their way into a flight.
#[derive(Debug, Default)]
pub(super) struct Rows {
    /// The first rows until they show whether the table is in order; all rows if it is not.
    held: Vec<Row>,
    order: Order,
    /// The last row in order. It waits for the next: only that shows whether a time far ahead is
    /// damaged, after which all later rows would be too early.
    waiting: Option<Row>,
    /// The last row in the flight.
    last: Option<Row>,
    /// Times of the rows in the flight, s.
    times: Vec<f64>,
    /// Time after which the clock starts again at 0, s.
    period: Option<f64>,
    /// Time that its restarts add, s.
    restarts: f64,
}

/// Order of a table's rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Order {
    /// Too few rows are known.
    #[default]
    Unknown,
    /// Each row is later than the one before, except where a time is damaged or the clock restarts.
    Rising,
    /// The rows are not in the order of time.
    Unsorted,
}

/// Whether a row at the time `to` may follow one at `from`, s.
fn continues(from: f64, to: f64) -> bool {
    (0.0..=STEP_MAX_S).contains(&(to - from))
}

impl Rows {
    /// No rows yet, of a table whose clock starts again at 0 after `period`, s, if it does.
    pub fn new(period: Option<f64>) -> Self {
        Self { period, ..Self::default() }
    }

    /// Adds the next row of the table.
    pub fn add(&mut self, row: Row, flight: &mut Flight, tally: &mut Tally) {
        if self.order == Order::Rising {
            return self.follow(row, flight, tally);
        }
        self.held.push(row);
        if self.order == Order::Unknown && self.held.len() == FIRST_ROWS {
            self.find_order(flight, tally);
        }
    }

    /// Finds the order from the rows so far: damage and restarts of a clock leave most rows later
    /// than the one before.
    fn find_order(&mut self, flight: &mut Flight, tally: &mut Tally) {
        let steps = || self.held.windows(2).map(|pair| [pair[0].time, pair[1].time]);
        let starts_again = |[from, to]: [f64; 2]| {
            self.period.is_some_and(|period| to < from && continues(from, to + period))
        };
        let backward = steps().filter(|[from, to]| to < from).count();
        if backward > self.held.len() / 10 && !steps().any(starts_again) {
            self.order = Order::Unsorted;
            return;
        }
        self.order = Order::Rising;
        for row in std::mem::take(&mut self.held) {
            self.follow(row, flight, tally);
        }
    }

    /// Adds the next row of a table in order.
    fn follow(&mut self, mut row: Row, flight: &mut Flight, tally: &mut Tally) {
        row.time += self.restarts;
        let Some(before) = self.waiting else {
            self.waiting = Some(row);
            return;
        };
        let last = self.times.last().copied();
        // A clock that reads more than its period, as a date does, never starts again.
        if let (Some(last), Some(period)) = (last, self.period)
            && before.time - self.restarts < period
            && row.time < before.time
            && continues(last, before.time)
            && continues(before.time, row.time + period)
        {
            self.restarts += period;
            row.time += period;
        }
        self.waiting = Some(row);
        let is_damaged =
            last.is_some_and(|last| before.time - last > STEP_MAX_S && continues(last, row.time));
        match is_damaged {
            true => tally.add("row whose time is far ahead of the rows around it", 1),
            false => self.put(before, flight, tally),
        }
    }

    /// Puts the rows that it still has into the flight. Returns the times of all.
    pub fn finish(mut self, flight: &mut Flight, tally: &mut Tally) -> Vec<f64> {
        if self.order == Order::Unknown {
            self.find_order(flight, tally);
        }
        if self.order == Order::Unsorted {
            self.held.sort_by(|a, b| a.time.total_cmp(&b.time));
            flight.facts.notes.push("rows were out of order and were sorted by time".to_owned());
        }
        for row in std::mem::take(&mut self.held).into_iter().chain(self.waiting.take()) {
            self.put(row, flight, tally);
        }
        self.times
    }

    fn put(&mut self, row: Row, flight: &mut Flight, tally: &mut Tally) {
        let before = self.last.replace(row);
        if before == Some(row) {
            return tally.add("duplicated row, with the time of the row before", 1);
        }
        let last = self.times.last().copied().unwrap_or(f64::NEG_INFINITY);
        let [kept, unordered] = keep(&row, flight);
        match (kept, unordered) {
            (0, 0) if row.time > last => self.times.push(row.time),
            (0, _) if row.time == last => tally.add("row with the time of the row before", 1),
            (0, _) => tally.add("row with an earlier time than the row before", 1),
            (_, unordered) => {
                tally.add("sample at or before the time of the one before", unordered);
                if row.time > last {
                    self.times.push(row.time);
                }
            }
        }
    }
}

/// Appends a row's samples. Returns how many were kept, and how many were not later than the last
/// of their stream.
fn keep(row: &Row, flight: &mut Flight) -> [u64; 2] {
    fn push<T>(stream: &mut Stream<T>, time: f64, value: Option<T>, count: &mut [u64; 2]) {
        if let Some(value) = value {
            count[usize::from(!stream.push(time, value))] += 1;
        }
    }
    let (time, mut count) = (row.time, [0, 0]);
    push(&mut flight.position, time, row.position, &mut count);
    push(&mut flight.velocity, time, row.velocity, &mut count);
    push(&mut flight.attitude, time, row.attitude, &mut count);
    push(&mut flight.body_rate, time, row.body_rate, &mut count);
    push(&mut flight.specific_force, time, row.specific_force, &mut count);
    push(&mut flight.outputs, time, row.outputs, &mut count);
    push(&mut flight.rotor_speed, time, row.rotor_speed, &mut count);
    push(&mut flight.voltage, time, row.voltage, &mut count);
    let setpoint = AttitudeSetpoint {
        attitude: row.setpoint_attitude,
        body_rate: row.setpoint_rate,
        thrust: row.setpoint_thrust,
    };
    let is_any =
        setpoint.attitude.is_some() || setpoint.body_rate.is_some() || setpoint.thrust.is_some();
    push(&mut flight.setpoint, time, is_any.then_some(setpoint), &mut count);
    count
}

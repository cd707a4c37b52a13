//! Maps the ground's clock to the vehicle's, from the time stamps of a whole log.
//!
//! A message that its sender stamps `vehicle` arrives at `ground`: `ground - vehicle` is the clock
//! offset plus the link's delay. The delay has a minimum, so the lower envelope of the difference
//! follows the offset, however late single messages are. The clocks may run at different and
//! varying rates: the envelope is a polygon. It restarts where the ground's clock steps.

/// A message's time stamps on both clocks, s, and the number of its frame in the log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Arrival {
    /// Number of the frame.
    pub index: u32,
    /// Time on the ground's clock, s.
    pub ground: f64,
    /// Time on the vehicle's clock, s.
    pub vehicle: f64,
}

impl Arrival {
    fn difference(&self) -> f64 {
        self.ground - self.vehicle
    }
}

/// A time on the ground's clock with the number of its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FrameTime {
    /// Number of the frame.
    pub index: u32,
    /// Time on the ground's clock, s.
    pub ground: f64,
}

/// A TIMESYNC exchange: the vehicle's clock read `vehicle` between the two ground times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Exchange {
    /// Ground time of the request, s.
    pub requested: f64,
    /// Ground time of the reply.
    pub answered: FrameTime,
    /// The vehicle's clock, s.
    pub vehicle: f64,
}

/// Smallest duration of a window of the envelope, s.
const WINDOW: f64 = 1.0;
/// Smallest number of messages in a window: few messages rarely include one with the least delay.
const WINDOW_MESSAGES: u32 = 50;
/// Largest relative skew of the clocks. Simulations that cannot keep up reach 0.01.
const SKEW_MAX: f64 = 0.02;
/// Shortest span for a skew estimate, s: a least delay is known to a millisecond or two.
const SKEW_SPAN_MIN: f64 = 10.0;
/// Jump of the envelope that counts as a step of the ground's clock, s.
const STEP: f64 = 0.25;
/// Windows on both sides of a step that must agree on it; a shorter stall of the link is not a
/// step.
const STEP_WINDOWS: usize = 10;
/// Largest distance from the vehicle's messages at which the map is valid, s.
const REACH: f64 = 2.0;
/// Largest disagreement of TIMESYNC with the messages' time stamps, s; beyond it, TIMESYNC refers
/// to a different clock.
const SYNC_DELAY_MAX: f64 = 0.5;
/// Tolerance for negative delays, which the 1 ms resolution of time stamps causes.
const RESOLUTION: f64 = 1.5e-3;

/// The messages with the least delay, one for each window.
#[derive(Clone, Debug, Default)]
pub(super) struct Envelope {
    closed: Vec<Arrival>,
    open: Option<Window>,
}

#[derive(Clone, Copy, Debug)]
struct Window {
    start: f64,
    count: u32,
    best: Arrival,
}

impl Envelope {
    /// Adds a message.
    pub fn add(&mut self, arrival: Arrival) {
        let fresh = Window { start: arrival.vehicle, count: 1, best: arrival };
        let Some(window) = &mut self.open else {
            self.open = Some(fresh);
            return;
        };
        if window.count >= WINDOW_MESSAGES && arrival.vehicle - window.start >= WINDOW {
            self.closed.push(window.best);
            *window = fresh;
            return;
        }
        window.count += 1;
        if arrival.difference() < window.best.difference() {
            window.best = arrival;
        }
    }

    /// All points, including the one of the open window.
    fn points(&self) -> impl Iterator<Item = Arrival> {
        self.closed.iter().copied().chain(self.open.map(|window| window.best))
    }
}

/// The shift that maps vehicle times of `source` to the clock of `reference`: the median difference
/// of their envelopes. It is 0 if they differ by less than [`STEP`], which is a different delay and
/// not a different clock.
pub(super) fn shift_onto(reference: &Envelope, source: &Envelope) -> f64 {
    let known: Vec<Arrival> = reference.points().collect();
    let mut shifts: Vec<f64> = source
        .points()
        .filter_map(|point| {
            let after = known.partition_point(|k| k.index < point.index);
            let (a, b) =
                (known.get(after.saturating_sub(1))?, known.get(after.min(known.len() - 1))?);
            let near = if (point.ground - a.ground).abs() < (b.ground - point.ground).abs() {
                a
            } else {
                b
            };
            Some(point.difference() - near.difference())
        })
        .collect();
    let middle = shifts.len() / 2;
    if shifts.is_empty() {
        return 0.0;
    }
    let median = *shifts.select_nth_unstable_by(middle, f64::total_cmp).1;
    if median.abs() < STEP { 0.0 } else { median }
}

/// Maps the ground's clock to the vehicle's.
#[derive(Clone, Debug, Default)]
pub(super) struct ClockMap {
    pieces: Vec<Piece>,
    /// Minimum delay of the downlink, s.
    delay: f64,
}

/// The map between two steps of the ground's clock.
#[derive(Clone, Debug)]
struct Piece {
    /// Range of its frames' numbers.
    first: u32,
    last: u32,
    /// The envelope: at least one point, increasing on both clocks.
    knots: Vec<Arrival>,
}

impl ClockMap {
    /// Builds the map from envelopes, each with a shift of its vehicle times, given a minimum
    /// downlink delay of `assumed_delay`.
    pub fn new<'a>(
        envelopes: impl Iterator<Item = (&'a Envelope, f64)>,
        assumed_delay: f64,
    ) -> Self {
        let mut points: Vec<Arrival> = envelopes
            .flat_map(|(envelope, shift)| {
                envelope.points().map(move |p| Arrival { vehicle: p.vehicle + shift, ..p })
            })
            .collect();
        points.sort_by(|a, b| a.vehicle.total_cmp(&b.vehicle).then(a.index.cmp(&b.index)));
        let points = thinned(&points);
        let pieces = split_at_steps(&points).into_iter().map(Piece::new).collect();
        Self { pieces, delay: assumed_delay }
    }

    /// Relative rate of the ground's clock to the vehicle's, minus 1, from the ends of the longest
    /// piece; `None` if it is too short.
    pub fn skew(&self) -> Option<f64> {
        let spans = self.pieces.iter().filter_map(|piece| {
            let (first, last) = (piece.knots.first()?, piece.knots.last()?);
            Some((last.vehicle - first.vehicle, last.ground - first.ground))
        });
        let (vehicle, ground) = spans.max_by(|a, b| a.0.total_cmp(&b.0))?;
        (vehicle >= SKEW_SPAN_MIN).then(|| ground / vehicle - 1.0)
    }

    /// Number of steps of the ground's clock.
    pub fn steps(&self) -> u64 {
        self.pieces.len().saturating_sub(1) as u64
    }

    /// Measures the minimum downlink delay with TIMESYNC. Returns whether the exchanges agree with
    /// the messages' time stamps; if not, the map stays unchanged.
    pub fn synchronise(&mut self, exchanges: &[Exchange]) -> bool {
        let round_trip = |e: &Exchange| e.answered.ground - e.requested;
        let sound = exchanges.iter().filter(|e| round_trip(e) >= 0.0);
        let least = sound.clone().map(round_trip).fold(f64::INFINITY, f64::min);
        let mut delays: Vec<f64> = sound
            .filter(|e| round_trip(e) <= 1.5 * least + RESOLUTION)
            .filter_map(|e| {
                // The vehicle reads its clock in the middle of the round trip.
                let middle = 0.5 * (e.requested + e.answered.ground);
                let piece = self.piece(e.answered.index)?;
                Some(e.vehicle - piece.vehicle_at(middle))
            })
            .collect();
        if delays.is_empty() {
            return false;
        }
        let middle = delays.len() / 2;
        let delay = *delays.select_nth_unstable_by(middle, f64::total_cmp).1;
        let lowest = -(0.5 * least + RESOLUTION);
        if !(lowest..SYNC_DELAY_MAX).contains(&delay) {
            return false;
        }
        self.delay = delay.max(0.0);
        true
    }

    /// The vehicle's clock at a time on the ground's; `None` within a step of the ground's clock or
    /// far from any message of the vehicle.
    pub fn vehicle_time(&self, frame_time: FrameTime) -> Option<f64> {
        let piece = self.piece(frame_time.index)?;
        let (first, last) = (piece.knots.first()?, piece.knots.last()?);
        let near = first.ground - REACH..=last.ground + REACH;
        near.contains(&frame_time.ground).then(|| piece.vehicle_at(frame_time.ground) + self.delay)
    }

    /// The ground's clock at a time on the vehicle's, as if messages had no delay; `None` without
    /// messages.
    pub fn ground_time(&self, vehicle: f64) -> Option<f64> {
        let begins = |piece: &Piece| piece.knots.first().is_some_and(|k| k.vehicle <= vehicle);
        let at = self.pieces.partition_point(begins).saturating_sub(1);
        self.pieces.get(at).map(|piece| piece.ground_at(vehicle))
    }

    /// The piece that contains a frame; the first and last pieces extend beyond their frames.
    fn piece(&self, index: u32) -> Option<&Piece> {
        let next = self.pieces.partition_point(|piece| piece.first <= index);
        let piece = self.pieces.get(next.saturating_sub(1))?;
        let is_last = next == self.pieces.len();
        (is_last || next == 0 || index <= piece.last).then_some(piece)
    }
}

impl Piece {
    fn new(points: &[Arrival]) -> Self {
        let indices = points.iter().map(|p| p.index);
        Self {
            first: indices.clone().min().unwrap_or_default(),
            last: indices.max().unwrap_or_default(),
            knots: lower_envelope(points),
        }
    }

    /// The vehicle's clock, as if messages had no delay.
    fn vehicle_at(&self, ground: f64) -> f64 {
        self.read(ground, |knot| [knot.ground, knot.vehicle])
    }

    /// The ground's clock, as if messages had no delay.
    fn ground_at(&self, vehicle: f64) -> f64 {
        self.read(vehicle, |knot| [knot.vehicle, knot.ground])
    }

    /// Maps `time` from one clock to another; `clocks` returns a knot's times on the source and
    /// target clocks.
    fn read(&self, time: f64, clocks: impl Fn(&Arrival) -> [f64; 2]) -> f64 {
        let Some(last) = self.knots.len().checked_sub(2) else {
            let only = self.knots.first().map(clocks);
            return only.map_or(f64::NAN, |[from, to]| time - from + to);
        };
        let a = self.knots.partition_point(|k| clocks(k)[0] <= time).saturating_sub(1).min(last);
        let ([from, to], [next, beyond]) = (clocks(&self.knots[a]), clocks(&self.knots[a + 1]));
        to + (time - from) / (next - from) * (beyond - to)
    }
}

/// One point for each window, over all sources.
fn thinned(points: &[Arrival]) -> Vec<Arrival> {
    let mut out: Vec<Arrival> = Vec::new();
    let mut start = f64::NEG_INFINITY;
    for point in points {
        match out.last_mut() {
            Some(last) if point.vehicle - start < WINDOW => {
                if point.difference() < last.difference() {
                    *last = *point;
                }
            }
            _ => {
                start = point.vehicle;
                out.push(*point);
            }
        }
    }
    out
}

/// Splits where the envelope steps and stays.
fn split_at_steps(points: &[Arrival]) -> Vec<&[Arrival]> {
    let least =
        |points: &[Arrival]| points.iter().map(Arrival::difference).fold(f64::INFINITY, f64::min);
    let mut pieces = Vec::new();
    let mut start = 0;
    for k in 1..points.len() {
        let (a, b) = (&points[k - 1], &points[k]);
        let allowed = |span: f64| STEP + SKEW_MAX * span;
        if (b.difference() - a.difference()).abs() < allowed(b.vehicle - a.vehicle) {
            continue;
        }
        let before = &points[k.saturating_sub(STEP_WINDOWS).max(start)..k];
        let after = &points[k..points.len().min(k + STEP_WINDOWS)];
        let span =
            after.last().map_or(0.0, |p| p.vehicle) - before.first().map_or(0.0, |p| p.vehicle);
        if (least(after) - least(before)).abs() > allowed(span) {
            pieces.push(&points[start..k]);
            start = k;
        }
    }
    if start < points.len() {
        pieces.push(&points[start..]);
    }
    pieces
}

/// The points on the lower envelope: none is later than another point plus the largest skew allows.
fn lower_envelope(points: &[Arrival]) -> Vec<Arrival> {
    let mut keep = vec![true; points.len()];
    let mut sweep = |order: &mut dyn Iterator<Item = usize>| {
        let mut last: Option<&Arrival> = None;
        for k in order {
            let point = &points[k];
            let limit = last.map_or(f64::INFINITY, |last| {
                last.difference() + SKEW_MAX * (point.vehicle - last.vehicle).abs()
            });
            if point.difference() <= limit {
                last = Some(point);
            } else {
                keep[k] = false;
            }
        }
    };
    sweep(&mut (0..points.len()));
    sweep(&mut (0..points.len()).rev());
    let mut knots: Vec<Arrival> = Vec::new();
    for (point, _) in points.iter().zip(keep).filter(|(_, keep)| *keep) {
        let ascends = |last: &Arrival| point.ground > last.ground && point.vehicle > last.vehicle;
        if knots.last().is_none_or(ascends) {
            knots.push(*point);
        }
    }
    knots
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Messages every 4 ms for `seconds`; `ground` maps the vehicle's time and a delay.
    fn envelope(seconds: f64, ground: impl Fn(f64) -> f64) -> Envelope {
        let mut envelope = Envelope::default();
        let mut noise = 1u64;
        for index in 0..(seconds / 0.004) as u32 {
            let vehicle = f64::from(index) * 0.004;
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let jitter = -((noise >> 11) as f64 / (1u64 << 53) as f64).ln() * 1.1e-3;
            let ground = ground(vehicle) + 1.5e-3 + jitter;
            envelope.add(Arrival { index, ground, vehicle });
        }
        envelope
    }

    fn frame_time(vehicle: f64, ground: f64) -> FrameTime {
        FrameTime { index: (vehicle / 0.004) as u32, ground }
    }

    #[test]
    fn constant_offset_is_recovered_within_a_tenth_of_a_millisecond() {
        let envelope = envelope(20.0, |v| v + 1000.0);
        let map = ClockMap::new([(&envelope, 0.0)].into_iter(), 1.5e-3);
        for v in [0.0, 0.5, 7.3, 19.9] {
            let found = map.vehicle_time(frame_time(v, v + 1000.0)).unwrap();
            assert!((found - v).abs() < 1e-4, "{v}: {found}");
        }
        assert_eq!(map.steps(), 0);
    }

    #[test]
    fn clock_skew_is_tracked() {
        let ground = |v: f64| 50.0 + 1.008 * v + 0.003 * (0.3 * v).sin();
        let envelope = envelope(60.0, ground);
        let map = ClockMap::new([(&envelope, 0.0)].into_iter(), 1.5e-3);
        for v in [1.0, 20.0, 40.5, 59.0] {
            let found = map.vehicle_time(frame_time(v, ground(v))).unwrap();
            assert!((found - v).abs() < 1e-3, "{v}: {found}");
        }
    }

    #[test]
    fn stalled_link_is_not_taken_for_a_clock_step() {
        // Everything sent from 10 to 14 s arrives at 14 s.
        let stalled = |v: f64| if (10.0..14.0).contains(&v) { 14.0 } else { v };
        let envelope = envelope(40.0, stalled);
        let map = ClockMap::new([(&envelope, 0.0)].into_iter(), 1.5e-3);
        assert_eq!(map.steps(), 0);
        let found = map.vehicle_time(frame_time(12.0, 12.0)).unwrap();
        assert!((found - 12.0).abs() < 5e-3, "{found}");
    }

    #[test]
    fn ground_clock_step_starts_a_new_map_segment() {
        for step in [5.0, -5.0] {
            let ground = |v: f64| if v < 20.0 { v + 100.0 } else { v + 100.0 + step };
            let envelope = envelope(40.0, ground);
            let map = ClockMap::new([(&envelope, 0.0)].into_iter(), 1.5e-3);
            assert_eq!(map.steps(), 1);
            for v in [5.0, 18.0, 22.0, 39.0] {
                let found = map.vehicle_time(frame_time(v, ground(v))).unwrap();
                assert!((found - v).abs() < 1e-3, "{v}: {found}");
            }
        }
    }

    #[test]
    fn timesync_measures_the_delay() {
        let envelope = envelope(20.0, |v| v + 0.008);
        let mut map = ClockMap::new([(&envelope, 0.0)].into_iter(), 0.0);
        let exchange = |v: f64| Exchange {
            requested: v - 0.009,
            answered: frame_time(v, v + 0.0095),
            vehicle: v,
        };
        let exchanges: Vec<_> = (1..100).map(|k| exchange(f64::from(k) * 0.2)).collect();
        assert!(map.synchronise(&exchanges));
        let found = map.vehicle_time(frame_time(10.0, 10.0)).unwrap();
        assert!((found - 10.0).abs() < 5e-4, "{found}");
        let other_epoch: Vec<_> =
            exchanges.iter().map(|e| Exchange { vehicle: e.vehicle + 1.7e9, ..*e }).collect();
        assert!(!map.synchronise(&other_epoch));
    }

    #[test]
    fn different_epoch_is_detected_and_different_delay_is_ignored() {
        let boot = envelope(20.0, |v| v + 100.0);
        let mut unix = Envelope::default();
        for point in boot.points() {
            unix.add(Arrival { vehicle: point.vehicle + 1.7e9, ..point });
        }
        assert!((shift_onto(&boot, &unix) + 1.7e9).abs() < 1e-3);
        assert_eq!(shift_onto(&boot, &envelope(20.0, |v| v + 100.05)), 0.0);
    }
}

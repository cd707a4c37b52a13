//! The coefficients of a flight that the likelihood uses.

use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::spectrum::{BANDS, band, frequency};
use crate::diagnose::likelihood::channels::{ATTITUDE, CHANNELS, COMMAND, FORCE, RATE, VELOCITY};

/// Share of a stream's rate up to which it is used: linear interpolation between samples holds up
/// to there.
const RATE_SHARE: f64 = 0.3;
/// Upper frequency limit of the body rate, Hz. Above it the gyro's noise is in its increments and,
/// through feedback, in the outputs, and a fit mistakes their correlation for a delay.
const RATE_MAX_HZ: f64 = 6.0;
/// Upper frequency limit of the command, Hz. Feedback puts noise into every setpoint, and above
/// this limit the noise dominates. Jitter of the link then looks like a lower gain.
const COMMAND_MAX_HZ: f64 = 2.5;
/// Upper frequency limit without an attitude, Hz: the vehicle is taken to be level on average.
const LEVEL_MAX_HZ: f64 = 0.25;

/// Channels that are then compared with rest: the climb and the body rate.
pub(in crate::diagnose) const AT_REST: [usize; 4] = [VELOCITY + 2, RATE, RATE + 1, RATE + 2];

/// Bin of a coefficient: its channel and band.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bin(u16);

impl Bin {
    /// Number of channels times bands.
    pub const COUNT: usize = CHANNELS * BANDS.len();

    fn new(channel: usize, band: usize) -> Self {
        Self(Self::index_of(channel, band) as u16)
    }

    /// Index of the bin of a channel and a band.
    pub fn index_of(channel: usize, band: usize) -> usize {
        channel * BANDS.len() + band
    }

    /// Channel of the bin of this index.
    pub fn channel_of(index: usize) -> usize {
        index / BANDS.len()
    }

    /// The channel of this bin.
    pub fn channel(self) -> usize {
        Self::channel_of(self.index())
    }

    /// Index in 0..[`Bin::COUNT`].
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// The coefficients of a flight that are used, by bin.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Bin of each coefficient.
    pub bins: Vec<Bin>,
    /// Index of the first coefficient of each block, then the total.
    pub blocks: Vec<usize>,
    /// Frequency up to which each channel is used, Hz; 0 where the log lacks it.
    limits: [f64; CHANNELS],
    /// Whether equations are compared with assumed rest rather than with reported motion.
    pub(in crate::diagnose) is_at_rest: bool,
}

impl Layout {
    /// Uses every channel that the log holds.
    pub fn new(flight: &PreparedFlight) -> Self {
        Self::without(flight, &[])
    }

    /// As [`new`](Self::new), without the channels `unused`.
    pub fn without(flight: &PreparedFlight, unused: &[usize]) -> Self {
        let channels = &flight.channels;
        let has_pose = channels.attitude && channels.body_rate;
        let input = flight.outputs.rate();
        let limit = |rates: &[f64]| rates.iter().fold(input, |a, b| a.min(*b)) * RATE_SHARE;
        let mut limits = [0.0; CHANNELS];
        let mut group = |start: usize, count: usize, limit: f64| {
            limits[start..start + count].fill(limit);
        };
        if channels.velocity && channels.attitude {
            group(VELOCITY, 3, limit(&[flight.velocity.rate(), flight.attitude.rate()]));
        }
        if channels.specific_force {
            // Without a velocity, the drag is unknown but the thrust is known.
            group(FORCE, 3, limit(&[flight.specific_force.rate()]));
        }
        if channels.body_rate {
            group(RATE, 3, limit(&[flight.body_rate.rate()]).min(RATE_MAX_HZ));
        }
        if has_pose {
            let rates = [flight.attitude.rate(), flight.body_rate.rate()];
            group(ATTITUDE, 3, rates[0].min(rates[1]) * RATE_SHARE);
        }
        if channels.shows_loop() {
            let rates = [flight.attitude.rate(), flight.body_rate.rate()];
            group(COMMAND, 4, limit(&rates).min(COMMAND_MAX_HZ));
        }
        let is_at_rest = !channels.attitude && channels.velocity && !channels.body_rate;
        if is_at_rest {
            // With only position and outputs: the vehicle hovers on average, and neither climbs nor
            // turns.
            AT_REST.iter().for_each(|channel| limits[*channel] = LEVEL_MAX_HZ);
        }
        unused.iter().for_each(|channel| limits[*channel] = 0.0);
        let mut layout = Self { bins: Vec::new(), blocks: vec![0], limits, is_at_rest };
        for block in &flight.blocks {
            for channel in 0..CHANNELS {
                for index in layout.used(channel, block) {
                    if let Some(band) = band(frequency(index, block.cells)) {
                        layout.bins.push(Bin::new(channel, band));
                    }
                }
            }
            layout.blocks.push(layout.bins.len());
        }
        layout
    }

    /// Frequency up to which a channel is used, Hz; 0 where the log lacks it.
    pub fn limit_hz(&self, channel: usize) -> f64 {
        self.limits[channel]
    }

    /// Whether any coefficient of this channel is used.
    pub fn has(&self, channel: usize) -> bool {
        self.limits[channel] > 0.0
    }

    /// Indices of the coefficients that are used of a block's channel.
    pub(in crate::diagnose) fn used(
        &self,
        channel: usize,
        block: &Block,
    ) -> std::ops::Range<usize> {
        // Leaves out the mean of a channel that contains the bias of the accelerometer or the gyro.
        let first = usize::from(
            (FORCE..FORCE + 3).contains(&channel) || (ATTITUDE..ATTITUDE + 3).contains(&channel),
        );
        let upper = self.limits[channel].min(BANDS[BANDS.len() - 1]);
        let mut end = first;
        while end < block.cells && frequency(end, block.cells) < upper {
            end += 1;
        }
        first..end
    }
}

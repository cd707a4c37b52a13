//! Which coefficients of a flight are used.

use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::spectrum::{BANDS, band, frequency};
use crate::diagnose::likelihood::channels::{ATTITUDE, CHANNELS, COMMAND, FORCE, RATE, VELOCITY};

/// Share of a stream's rate up to which it is used: a linear interpolation between samples
/// holds to that.
const RATE_SHARE: f64 = 0.3;
/// The body rate is used up to here, Hz: above, the gyro's noise is both in its increments
/// and, by feedback, in the outputs, and their correlation would pass for a delay.
const RATE_MAX_HZ: f64 = 6.0;
/// The command is used up to here, Hz: feedback puts noise into every setpoint, and above this
/// it outweighs what is asked for; a jitter of the link then looks like a lower gain.
const COMMAND_MAX_HZ: f64 = 2.5;
/// Without an attitude only what lasts is used, and the vehicle is taken to be level, Hz.
const LEVEL_MAX_HZ: f64 = 0.25;

/// What is compared with rest there: the climb and the body rate.
pub(in crate::diagnose) const AT_REST: [usize; 4] = [VELOCITY + 2, RATE, RATE + 1, RATE + 2];

/// Place of a coefficient: its channel and band.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place(u16);

impl Place {
    /// Number of places.
    pub const COUNT: usize = CHANNELS * BANDS.len();

    fn new(channel: usize, band: usize) -> Self {
        Self(Self::index_of(channel, band) as u16)
    }

    /// Index of the place of a channel and a band.
    pub fn index_of(channel: usize, band: usize) -> usize {
        channel * BANDS.len() + band
    }

    /// Channel of the place of this index.
    pub fn channel_of(index: usize) -> usize {
        index / BANDS.len()
    }

    /// Its channel.
    pub fn channel(self) -> usize {
        Self::channel_of(self.index())
    }

    /// Index in 0..[`Place::COUNT`].
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// The coefficients of a flight that are used.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Of each coefficient its place.
    pub places: Vec<Place>,
    /// First coefficient of each block, and the end.
    pub blocks: Vec<usize>,
    /// Of each channel, the frequency up to which it is used; 0 where the log lacks it, Hz.
    limits: [f64; CHANNELS],
    /// Whether equations are compared with rest, which is believed, and not with what was read.
    pub(in crate::diagnose) is_at_rest: bool,
}

impl Layout {
    /// What can be used of a flight.
    pub fn new(flight: &PreparedFlight) -> Self {
        Self::without(flight, &[])
    }

    /// The same without the channels `unused`.
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
            // Without a velocity drag is not known; the thrust is.
            group(FORCE, 3, limit(&[flight.specific_force.rate()]));
        }
        if channels.body_rate {
            group(RATE, 3, limit(&[flight.body_rate.rate()]).min(RATE_MAX_HZ));
        }
        if has_pose {
            let rates = [flight.attitude.rate(), flight.body_rate.rate()];
            group(ATTITUDE, 3, rates[0].min(rates[1]) * RATE_SHARE);
        }
        if channels.setpoint {
            let rates = [flight.attitude.rate(), flight.body_rate.rate()];
            group(COMMAND, 4, limit(&rates).min(COMMAND_MAX_HZ));
        }
        let is_at_rest = !channels.attitude && channels.velocity && !channels.body_rate;
        if is_at_rest {
            // Position and outputs alone: hovering on average, it neither climbs nor turns.
            AT_REST.iter().for_each(|channel| limits[*channel] = LEVEL_MAX_HZ);
        }
        unused.iter().for_each(|channel| limits[*channel] = 0.0);
        let mut layout = Self { places: Vec::new(), blocks: vec![0], limits, is_at_rest };
        for block in &flight.blocks {
            for channel in 0..CHANNELS {
                for index in layout.used(channel, block) {
                    if let Some(band) = band(frequency(index, block.cells)) {
                        layout.places.push(Place::new(channel, band));
                    }
                }
            }
            layout.blocks.push(layout.places.len());
        }
        layout
    }

    /// Whether any flight time of this channel is used.
    pub fn has(&self, channel: usize) -> bool {
        self.limits[channel] > 0.0
    }

    /// Indices of a block's coefficients that are used.
    pub(in crate::diagnose) fn used(
        &self,
        channel: usize,
        block: &Block,
    ) -> std::ops::Range<usize> {
        // Biases of accelerometer and gyro are the means of their channels.
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

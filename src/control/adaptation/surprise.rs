//! Whether innovations agree for long enough to indicate a change.

/// Time over which they must agree, s.
const AGREE_S: f64 = 0.1;
/// Time over which their usual size is learned, s.
const USUAL_S: f64 = 5.0;

/// The filtered mean of normalised innovations, and its usual size. Gusts, or rotors that lag more
/// than the model says, make innovations agree all the time: only what is unusual is a change.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surprise {
    mean: f64,
    /// Mean square of `mean` over that of white innovations; at least 1.
    usual: f64,
}

impl Default for Surprise {
    fn default() -> Self {
        Self { mean: 0.0, usual: 1.0 }
    }
}

impl Surprise {
    /// Takes an innovation in standard deviations, `dt` seconds after the last. Returns whether the
    /// mean exceeds its usual size by the factor `least`; it then starts again.
    pub fn observe(&mut self, deviation: f64, dt: f64, least: f64) -> bool {
        let share = (dt / AGREE_S).min(1.0);
        // Variance of the mean of white innovations with these weights.
        let white = share / (2.0 - share);
        self.mean += share * (deviation - self.mean);
        let square = self.mean * self.mean / white;
        let is_change = square > least * least * self.usual;
        self.usual = (self.usual + (dt / USUAL_S).min(1.0) * (square - self.usual)).max(1.0);
        if is_change {
            self.mean = 0.0;
        }
        is_change
    }

    /// Discards the mean: the next innovation does not continue the last ones.
    pub fn restart(&mut self) {
        self.mean = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.01;

    /// Number of changes among these innovations.
    fn changes(surprise: &mut Surprise, innovations: impl Iterator<Item = f64>) -> usize {
        innovations.filter(|innovation| surprise.observe(*innovation, DT, 4.0)).count()
    }

    #[test]
    fn step_is_a_change_and_an_old_oscillation_is_none() {
        let white = |tick: u32| f64::from(tick * 7919 % 101) / 29.0 - 1.72;
        let mut surprise = Surprise::default();
        assert_eq!(changes(&mut surprise, (0..2000).map(white)), 0);
        let mut stepped = surprise;
        assert!(changes(&mut stepped, (0..30).map(|tick| 4.0 + white(tick))) > 0);
        let swaying = |tick: u32| 3.0 * (0.03 * f64::from(tick)).sin() + white(tick);
        assert!(changes(&mut surprise, (0..1000).map(swaying)) > 0, "new");
        assert_eq!(changes(&mut surprise, (1000..3000).map(swaying)), 0, "usual");
        let gone = |tick: u32| 12.0 + swaying(tick);
        assert!(changes(&mut surprise, (3000..3030).map(gone)) > 0, "beyond the usual");
    }
}

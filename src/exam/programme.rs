//! The flights of a case: the same kinds in each case, with other numbers.

use std::f64::consts::TAU;

use super::draw::Draw;
use super::motion::{Motion, Tone, Waypoint};

/// How boldly flights move, and how low.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vigour {
    /// Peak speed, m/s.
    pub speed: f64,
    /// Peak acceleration, m/s^2.
    pub acceleration: f64,
    /// Height of low passes, m.
    pub low: f64,
}

/// Limits of a programme's manoeuvres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Restriction {
    /// No limit.
    #[default]
    None,
    /// Hover with small steps at one heading.
    OneHeadingHover,
    /// Every manoeuvre, far above the floor.
    High,
    /// Every manoeuvre, at one heading.
    NoYaw,
    /// Hover at a constant height, with headings all around.
    SteadyThrust,
}

impl Vigour {
    /// Draws for a vehicle with rotors of this radius, m.
    pub fn draw(draw: &mut Draw, rotor_radius_m: f64) -> Self {
        Self {
            speed: draw.within([2.0, 4.0]),
            acceleration: draw.within([3.0, 6.0]),
            low: (draw.within([2.5, 4.5]) * rotor_radius_m).max(0.15) + 0.05,
        }
    }
}

/// `count` flights of about `seconds` each, which start in hover.
pub fn programme(
    draw: &mut Draw,
    vigour: &Vigour,
    restriction: Restriction,
    count: usize,
    seconds: f64,
) -> Vec<Motion> {
    let above = if restriction == Restriction::High { 20.0 } else { 0.0 };
    let heading = draw.within([0.0, TAU]);
    (0..count)
        .map(|number| {
            let yaw = match restriction {
                Restriction::OneHeadingHover | Restriction::NoYaw => heading,
                _ => draw.within([0.0, TAU]),
            };
            let start = [
                draw.within([-1.0, 1.0]),
                draw.within([-1.0, 1.0]),
                -draw.within([2.0, 3.5]) - above,
                yaw,
            ];
            let mut flight =
                Composer { draw, vigour, restriction, motion: Motion::at(start), above };
            flight.motion.hold(0.7);
            match restriction {
                Restriction::OneHeadingHover | Restriction::SteadyThrust => flight.hover(seconds),
                _ => match number % 4 {
                    0 => flight.sines(seconds),
                    1 => flight.technique(seconds),
                    2 => flight.fast(seconds),
                    _ => flight.points(seconds),
                },
            }
            flight.motion
        })
        .collect()
}

struct Composer<'a> {
    draw: &'a mut Draw,
    vigour: &'a Vigour,
    restriction: Restriction,
    motion: Motion,
    /// Added to every height, m.
    above: f64,
}

impl Composer<'_> {
    fn turns(&self) -> bool {
        !matches!(self.restriction, Restriction::NoYaw | Restriction::OneHeadingHover)
    }

    /// A sinusoid with peak speed and acceleration within shares of the limits.
    fn tone(&mut self, axis: usize, share: [f64; 2]) -> Tone {
        let (speed, acceleration) = if axis == 3 {
            (self.draw.within([0.6, 1.8]), self.draw.within([1.5, 4.0]))
        } else {
            (
                self.vigour.speed * self.draw.within(share),
                self.vigour.acceleration * self.draw.within(share),
            )
        };
        let omega = acceleration / speed;
        Tone {
            axis,
            amplitude: speed / omega,
            period_s: TAU / omega,
            phase: self.draw.within([0.0, TAU]),
        }
    }

    fn sines(&mut self, seconds: f64) {
        let mut tones = Vec::new();
        for axis in 0..2 {
            tones.push(self.tone(axis, [0.4, 0.7]));
            tones.push(self.tone(axis, [0.15, 0.3]));
        }
        let mut down = self.tone(2, [0.2, 0.5]);
        down.amplitude = down.amplitude.min(1.2);
        tones.push(down);
        if self.turns() {
            tones.push(self.tone(3, [0.0, 1.0]));
        }
        let left = seconds - self.motion.duration() - 0.5;
        self.motion.wave(tones, left);
    }

    /// Yaw spins, steps, low passes, climbs and descents, in random order.
    fn technique(&mut self, seconds: f64) {
        let mut order = [0, 1, 2, 3];
        self.draw.shuffle(&mut order);
        let mut turn = 0;
        while self.motion.duration() < seconds - 3.0 {
            match order[turn % 4] {
                0 if self.turns() => self.spin(),
                1 => self.steps(),
                2 => self.low_pass(),
                _ => self.climb(),
            }
            turn += 1;
        }
    }

    fn spin(&mut self) {
        let mut to = self.motion.end();
        to[3] += self.draw.sign() * self.draw.within([0.7, 1.2]) * TAU;
        let speed = self.vigour.speed;
        self.motion.move_at_limits(to, speed, self.vigour.acceleration);
    }

    fn steps(&mut self) {
        for _ in 0..2 {
            let mut to = self.motion.end();
            to[self.draw.below(3)] += self.draw.sign() * self.draw.within([0.4, 0.8]);
            if self.turns() {
                to[3] += self.draw.within([-0.6, 0.6]);
            }
            to[2] = to[2].min(-1.0 - self.above);
            let seconds = self.draw.within([1.2, 1.8]);
            self.motion.jump_to(to, seconds);
        }
    }

    fn low_pass(&mut self) {
        let (speed, acceleration) = (0.6 * self.vigour.speed, 0.6 * self.vigour.acceleration);
        let mut to = self.motion.end();
        let height = -to[2];
        to[2] = -self.vigour.low - self.above;
        self.motion.move_at_limits(to, speed, acceleration);
        let direction = self.draw.within([0.0, TAU]);
        let way = self.draw.within([1.5, 3.0]);
        to[0] += way * direction.cos();
        to[1] += way * direction.sin();
        self.motion.move_at_limits(to, speed, acceleration);
        self.motion.hold(0.4);
        to[2] = -height;
        self.motion.move_at_limits(to, speed, acceleration);
    }

    fn climb(&mut self) {
        let mut to = self.motion.end();
        let height = -to[2];
        to[2] = -(height + self.draw.within([3.0, 5.0]));
        let speed = self.vigour.speed;
        self.motion.move_at_limits(to, speed, self.vigour.acceleration);
        to[2] = -height;
        self.motion.move_at_limits(to, speed, self.vigour.acceleration);
    }

    /// A figure-eight, then a circle that rises and falls.
    fn fast(&mut self, seconds: f64) {
        let mut to = self.motion.end();
        to[2] -= 1.0;
        self.motion.move_at_limits(to, self.vigour.speed, self.vigour.acceleration);
        let half = 0.5 * (seconds - self.motion.duration());
        for (shape, share) in [(2.0, [0.4, 0.55]), (1.0, [0.6, 0.85])] {
            let long = self.tone(0, share);
            let short = Tone {
                axis: 1,
                amplitude: long.amplitude / shape,
                period_s: long.period_s / shape,
                phase: long.phase * shape + if shape == 1.0 { 0.25 * TAU } else { 0.0 },
            };
            let mut tones = vec![long, short];
            if self.turns() {
                tones.push(self.tone(3, [0.0, 1.0]));
            }
            let mut down = self.tone(2, [0.2, 0.4]);
            down.amplitude = down.amplitude.min(1.5);
            tones.push(down);
            self.motion.wave(tones, half);
        }
    }

    fn points(&mut self, seconds: f64) {
        while self.motion.duration() < seconds {
            let here = self.motion.end();
            let low = self.vigour.low + 0.1;
            let to: Waypoint = [
                self.draw.within([-2.5, 2.5]),
                self.draw.within([-2.5, 2.5]),
                -self.draw.within([low, 4.0]) - self.above,
                if self.turns() { here[3] + self.draw.within([-2.0, 2.0]) } else { here[3] },
            ];
            let speed = self.vigour.speed * self.draw.within([0.5, 1.0]);
            self.motion.move_at_limits(to, speed, self.vigour.acceleration);
            if self.draw.chance(0.4) {
                self.motion.hold(0.5);
            }
        }
    }

    /// Small moves at one height.
    fn hover(&mut self, seconds: f64) {
        while self.motion.duration() < seconds {
            let mut to = self.motion.end();
            to[0] = self.motion.start()[0] + self.draw.within([-0.15, 0.15]);
            to[1] = self.motion.start()[1] + self.draw.within([-0.15, 0.15]);
            if self.restriction == Restriction::SteadyThrust {
                to[3] += self.draw.within([-2.0, 2.0]);
            }
            self.motion.move_to(to, 3.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flights(restriction: Restriction) -> Vec<Motion> {
        let mut draw = Draw::new(5, 1);
        let vigour = Vigour::draw(&mut draw, 0.1);
        programme(&mut draw, &vigour, restriction, 8, 22.5)
    }

    #[test]
    fn flights_are_long_enough_and_stay_off_the_floor() {
        for motion in flights(Restriction::None) {
            assert!(motion.duration() > 18.0, "{}", motion.duration());
            for step in 0..450 {
                let point = motion.sample(0.05 * f64::from(step));
                assert!(point.position.down() < -0.1, "{point:?}");
                assert!(point.acceleration.norm() < 12.0 && point.velocity.norm() < 8.0);
            }
        }
    }

    #[test]
    fn restrictions_exclude_low_flight_and_yaw() {
        for motion in flights(Restriction::High) {
            assert!((0..450).all(|k| motion.sample(0.05 * f64::from(k)).position.down() < -15.0));
        }
        for restriction in [Restriction::NoYaw, Restriction::OneHeadingHover] {
            for motion in flights(restriction) {
                let yaw = motion.start()[3];
                assert!((0..450).all(|k| motion.sample(0.05 * f64::from(k)).yaw == yaw));
            }
        }
    }
}

//! The shortest script that still breaks a rule.

use super::script::Script;

/// Most flights spent on shrinking.
const FLIGHTS_MAX: usize = 120;
/// Times are halved down to this, s.
const SHORTEST_S: f64 = 0.03;

/// Removes what `fails` does not need: first faults, then their duration, then unusual settings of
/// the flight.
pub fn shrunk(script: &Script, mut fails: impl FnMut(&Script) -> bool) -> Script {
    let mut best = script.clone();
    let mut left = FLIGHTS_MAX;
    let mut attempt = |best: &mut Script, shorter: Script| {
        if shorter == *best || left == 0 {
            return false;
        }
        left -= 1;
        let is_enough = fails(&shorter);
        if is_enough {
            *best = shorter;
        }
        is_enough
    };
    let mut index = 0;
    while index < best.faults.len() {
        let mut shorter = best.clone();
        shorter.faults.remove(index);
        if !attempt(&mut best, shorter) {
            index += 1;
        }
    }
    for index in 0..best.faults.len() {
        while best.faults[index].for_s > 2.0 * SHORTEST_S {
            let mut shorter = best.clone();
            shorter.faults[index].for_s = (500.0 * best.faults[index].for_s).round() * 1e-3;
            if !attempt(&mut best, shorter) {
                break;
            }
        }
    }
    let plain = Script { clock_rate: 1.0, ..best.clone() };
    attempt(&mut best, plain);
    let hover = "family = \"hover\"\naltitude_m = 1.0\nduration_s = 3.0\n".to_owned();
    let plain = Script { trajectory: hover, ..best.clone() };
    attempt(&mut best, plain);
    let plain = Script { signed: false, ..best.clone() };
    attempt(&mut best, plain);
    let plain = Script { law: "lqr".to_owned(), ..best.clone() };
    attempt(&mut best, plain);
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::campaign::draw;
    use crate::campaign::script::{Fault, Timed};

    #[test]
    fn shrinking_removes_unneeded_faults() {
        let foreign = Timed { at_s: 3.0, for_s: 4.0, fault: Fault::Foreign { system: 77 } };
        let mut script = draw::script(1, 1);
        script.faults.insert(1, foreign);
        let fails = |script: &Script| {
            script.faults.iter().any(|it| it.fault == foreign.fault && it.for_s >= 0.9)
        };
        let shrunk = shrunk(&script, fails);
        assert_eq!(shrunk.faults, [Timed { for_s: 1.0, ..foreign }]);
        assert!(fails(&shrunk) && shrunk.law == "lqr");
    }
}

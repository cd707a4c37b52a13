//! The vehicle's own reaction when setpoints stop or this program vanishes, from its parameters.

use message::parameters::Parameters;

/// The rules by which an autopilot reacts to a loss.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LossLaw {
    /// PX4 leaves OFFBOARD after COM_OF_LOSS_T without a setpoint. It always does so.
    Px4,
    /// ArduCopter only levels after GUID_TIMEOUT, stays in Guided and drifts. Only its failsafe for
    /// the loss of a ground station acts, which watches the HEARTBEATs of one system id.
    ArduCopter,
    /// The rules are unknown.
    Unknown,
}

/// The vehicle's reaction when this program vanishes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LossReaction {
    /// The vehicle acts, as this message says.
    Acts(String),
    /// Nothing acts.
    Nothing {
        /// Why nothing acts.
        why: String,
        /// How to fix that.
        cure: String,
    },
    /// A parameter that decides has not been read yet.
    Unread(&'static str),
}

impl LossLaw {
    /// The parameters that decide. An autopilot has only some of them, depending on its version.
    pub fn parameters(self) -> &'static [&'static str] {
        match self {
            Self::Px4 => &["COM_OF_LOSS_T", "COM_OBL_RC_ACT", "NAV_RCL_ACT"],
            Self::ArduCopter => &[
                "GUID_TIMEOUT",
                "FS_GCS_ENABLE",
                "FS_GCS_TIMEOUT",
                "FS_OPTIONS",
                "MAV_GCS_SYSID",
                "MAV_GCS_SYSID_HI",
                "SYSID_MYGCS",
            ],
            Self::Unknown => &[],
        }
    }

    /// The reaction that the read parameters imply for a program whose HEARTBEATs carry
    /// `own_system`.
    pub fn reaction(self, read: &Parameters, own_system: u8) -> LossReaction {
        match self {
            Self::Px4 => px4(read),
            Self::ArduCopter => arducopter(read, own_system),
            Self::Unknown => LossReaction::Acts("the vehicle's reaction is unknown".to_owned()),
        }
    }
}

fn px4(read: &Parameters) -> LossReaction {
    let Some(wait_s) = read.get("COM_OF_LOSS_T") else {
        return LossReaction::Unread("COM_OF_LOSS_T");
    };
    let Some(action) = read.get("COM_OBL_RC_ACT") else {
        return LossReaction::Unread("COM_OBL_RC_ACT");
    };
    let without_sticks = match read.get("NAV_RCL_ACT").map(|action| *action as i64) {
        None if (0..=2).contains(&(*action as i64)) => return LossReaction::Unread("NAV_RCL_ACT"),
        Some(1) => "Hold",
        Some(2) => "Return",
        Some(3) => "Land",
        Some(5) => "Termination, which stops the motors",
        Some(6) => "a stop of the motors",
        _ => "what NAV_RCL_ACT says",
    };
    // PARAM_VALUE carries f32.
    let wait_s = *wait_s as f32;
    let then = match *action as i64 {
        0 => format!("Position, or without sticks {without_sticks}"),
        1 => format!("Altitude, or without sticks {without_sticks}"),
        2 => format!("Stabilized, or without sticks {without_sticks}"),
        3 => "Return".to_owned(),
        4 => "Land".to_owned(),
        5 => "Hold".to_owned(),
        6 => "Termination, which stops the motors in the air".to_owned(),
        7 => "a stop of the motors in the air".to_owned(),
        other => format!("the action {other} of COM_OBL_RC_ACT"),
    };
    LossReaction::Acts(format!("after {wait_s} s without a setpoint PX4 goes to {then}"))
}

fn arducopter(read: &Parameters, own_system: u8) -> LossReaction {
    let Some(enable) = read.get("FS_GCS_ENABLE") else {
        return LossReaction::Unread("FS_GCS_ENABLE");
    };
    let first = read.get("MAV_GCS_SYSID").map(|id| ("MAV_GCS_SYSID", *id));
    let Some((name, first)) = first.or_else(|| Some(("SYSID_MYGCS", *read.get("SYSID_MYGCS")?)))
    else {
        return LossReaction::Unread("MAV_GCS_SYSID");
    };
    let last = read.get("MAV_GCS_SYSID_HI").copied().unwrap_or(0.0).max(first);
    let is_monitored = (first..=last).contains(&f64::from(own_system));
    let does = match *enable as i64 {
        0 => {
            return LossReaction::Nothing {
                why: "FS_GCS_ENABLE is 0: ArduCopter stays in Guided and drifts".to_owned(),
                cure: format!("set FS_GCS_ENABLE to 5 (land) and {name} to {own_system}"),
            };
        }
        1 => "returns",
        2 => "continues its mission, or returns",
        3 => "returns by SmartRTL, or by RTL",
        4 => "returns by SmartRTL, or lands",
        5 => "lands",
        6 => "lands by its mission, or returns",
        7 => "brakes, or lands",
        _ => "does what FS_GCS_ENABLE says",
    };
    if !is_monitored {
        return LossReaction::Nothing {
            why: format!(
                "its failsafe listens to system {first}, and this program is system {own_system}"
            ),
            cure: format!(
                "set {name} to {own_system}, or link.system to {first} where no other ground \
                 station has that id"
            ),
        };
    }
    let levels = read.get("GUID_TIMEOUT").map_or_else(String::new, |wait_s| {
        format!("after {} s without a setpoint ArduCopter levels; ", *wait_s as f32)
    });
    let wait_s = read.get("FS_GCS_TIMEOUT").copied().unwrap_or(5.0) as f32;
    // Bit 4 exempts modes that the pilot flies with the sticks. ArduCopter sets it by default.
    let spares_pilot = read.get("FS_OPTIONS").is_none_or(|options| *options as i64 & 16 != 0);
    let over_pilot = match spares_pilot {
        true => "",
        false => ", even in the pilot's own modes, because FS_OPTIONS lacks bit 4 (16)",
    };
    LossReaction::Acts(format!(
        "{levels}{wait_s} s after this program's last HEARTBEAT ArduCopter {does}{over_pilot}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(parameters: &[(&str, f64)]) -> Parameters {
        parameters.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect()
    }

    #[test]
    fn px4_always_leaves_offboard() {
        let known = [("COM_OF_LOSS_T", 0.2), ("COM_OBL_RC_ACT", 0.0), ("NAV_RCL_ACT", 2.0)];
        let LossReaction::Acts(text) = LossLaw::Px4.reaction(&read(&known), 254) else { panic!() };
        assert_eq!(
            text,
            "after 0.2 s without a setpoint PX4 goes to Position, or without sticks Return"
        );
        assert_eq!(
            LossLaw::Px4.reaction(&read(&known[..1]), 254),
            LossReaction::Unread("COM_OBL_RC_ACT")
        );
    }

    #[test]
    fn arducopter_loss_reaction_applies_only_to_its_gcs() {
        let reaction = |enable: f64, gcs: (&str, f64), high: f64| {
            let known = [("FS_GCS_ENABLE", enable), gcs, ("MAV_GCS_SYSID_HI", high)];
            LossLaw::ArduCopter.reaction(&read(&known), 254)
        };
        let is_nothing = |reaction| matches!(reaction, LossReaction::Nothing { .. });
        assert!(is_nothing(reaction(0.0, ("MAV_GCS_SYSID", 254.0), 0.0)));
        assert!(is_nothing(reaction(5.0, ("MAV_GCS_SYSID", 255.0), 0.0)));
        assert!(is_nothing(reaction(1.0, ("SYSID_MYGCS", 255.0), 0.0)));
        let LossReaction::Acts(text) = reaction(5.0, ("SYSID_MYGCS", 254.0), 0.0) else { panic!() };
        assert_eq!(text, "5 s after this program's last HEARTBEAT ArduCopter lands");
        let known = [("FS_GCS_ENABLE", 5.0), ("SYSID_MYGCS", 254.0), ("FS_OPTIONS", 0.0)];
        let LossReaction::Acts(text) = LossLaw::ArduCopter.reaction(&read(&known), 254) else {
            panic!()
        };
        assert!(
            text.ends_with("even in the pilot's own modes, because FS_OPTIONS lacks bit 4 (16)")
        );
        assert!(matches!(reaction(1.0, ("MAV_GCS_SYSID", 250.0), 255.0), LossReaction::Acts(_)));
    }
}

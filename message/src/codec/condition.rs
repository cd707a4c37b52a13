//! The vehicle's condition: mode and arming, health, battery, and whether it is landed.

use wire::dialect::*;

use crate::inbound::{Battery, ChargeState, Inbound, LandedState, SystemState};

/// Decodes a HEARTBEAT byte by byte: a vehicle type that the dialect lacks must not hide the
/// vehicle.
pub fn heartbeat(payload: &[u8]) -> Inbound {
    let byte = |index: usize| payload.get(index).copied().unwrap_or(0);
    Inbound::Heartbeat {
        custom_mode: u32::from_le_bytes([byte(0), byte(1), byte(2), byte(3)]),
        vehicle_type: byte(4),
        autopilot: byte(5),
        armed: byte(6) & MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED.bits() != 0,
        system: SystemState::from(byte(7)),
    }
}

pub(super) fn sys_status(data: &SYS_STATUS_DATA) -> Inbound {
    let health = data.onboard_control_sensors_health.bits();
    let enabled = data.onboard_control_sensors_enabled.bits();
    let in_use = data.onboard_control_sensors_present.bits() & enabled;
    Inbound::SysStatus { unhealthy: in_use & !health, health, enabled }
}

pub(super) fn landed_state(data: &EXTENDED_SYS_STATE_DATA) -> Inbound {
    Inbound::LandedState(match data.landed_state {
        MavLandedState::MAV_LANDED_STATE_ON_GROUND => LandedState::OnGround,
        MavLandedState::MAV_LANDED_STATE_IN_AIR => LandedState::InAir,
        MavLandedState::MAV_LANDED_STATE_TAKEOFF => LandedState::TakingOff,
        MavLandedState::MAV_LANDED_STATE_LANDING => LandedState::Landing,
        MavLandedState::MAV_LANDED_STATE_UNDEFINED => LandedState::Undefined,
    })
}

/// Cells are in mV, 65535 if unused. Autopilots that measure only the pack put its voltage in the
/// first cell and the overflow in the next, so the sum is right in both cases.
pub(super) fn battery(data: &BATTERY_STATUS_DATA) -> Inbound {
    let cells = data.voltages.iter().filter(|&&cell| cell != u16::MAX);
    let further = data.voltages_ext.iter().filter(|&&cell| cell != 0 && cell != u16::MAX);
    let (count, sum_mv) = cells
        .chain(further)
        .fold((0, 0.0), |(count, sum), &cell| (count + 1, sum + f64::from(cell)));
    Inbound::Battery(Battery {
        voltage: (count > 0).then_some(sum_mv / 1000.0),
        current: (data.current_battery >= 0).then(|| f64::from(data.current_battery) / 100.0),
        remaining: (0..=100)
            .contains(&data.battery_remaining)
            .then(|| f64::from(data.battery_remaining) / 100.0),
        charge: charge_state(data.charge_state),
    })
}

fn charge_state(state: MavBatteryChargeState) -> ChargeState {
    use MavBatteryChargeState as M;
    match state {
        M::MAV_BATTERY_CHARGE_STATE_OK | M::MAV_BATTERY_CHARGE_STATE_CHARGING => ChargeState::Ok,
        M::MAV_BATTERY_CHARGE_STATE_LOW => ChargeState::Low,
        M::MAV_BATTERY_CHARGE_STATE_CRITICAL
        | M::MAV_BATTERY_CHARGE_STATE_EMERGENCY
        | M::MAV_BATTERY_CHARGE_STATE_FAILED
        | M::MAV_BATTERY_CHARGE_STATE_UNHEALTHY => ChargeState::Critical,
        _ => ChargeState::Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn battery_voltage_is_decoded_from_cells_or_pack() {
        let voltage = |voltages, voltages_ext| {
            let data = BATTERY_STATUS_DATA {
                voltages,
                voltages_ext,
                current_battery: -1,
                battery_remaining: -1,
                ..Default::default()
            };
            match battery(&data) {
                Inbound::Battery(Battery { voltage, current: None, remaining: None, .. }) => {
                    voltage
                }
                other => panic!("{other:?}"),
            }
        };
        let unused = u16::MAX;
        let mut pack = [unused; 10];
        pack[0] = 16_200;
        assert_eq!(voltage(pack, [0; 4]), Some(16.2));
        let cells = [4_050, 4_050, 4_050, 4_050, unused, unused, unused, unused, unused, unused];
        assert_eq!(voltage(cells, [0; 4]), Some(16.2));
        assert_eq!(voltage([unused; 10], [0; 4]), None);
    }

    #[test]
    fn unknown_vehicle_type_still_decodes_as_a_heartbeat() {
        let payload = [0x00, 0x00, 0x06, 0x00, 250, 12, 0x81, 4, 3];
        let expected = Inbound::Heartbeat {
            autopilot: 12,
            vehicle_type: 250,
            armed: true,
            custom_mode: 0x0006_0000,
            system: SystemState::Active,
        };
        assert_eq!(heartbeat(&payload), expected);
    }
}

mod speed;

use crate::support::{Rng, build, entries};
use mcdpr_firmware::CableConfig;
use mcdpr_firmware::tension::{Demand, TensionLoop};
use mcdpr_protocol::{CableKey, ConfigKey};

/// Gains of a test, in the units of the configuration.
#[derive(Clone, Copy)]
struct Gains {
    law: i32,
    kp_milli: i32,
    kd_us: i32,
    ki_milli: i32,
    damping_mns_per_m: i32,
    filter_mhz: i32,
    /// mN/A, negative where a positive current pays out.
    force_per_ampere: i32,
    max_current_ma: i32,
}

const PAPER: Gains = Gains {
    law: 0,
    kp_milli: 2500,
    kd_us: 40_000,
    ki_milli: 0,
    damping_mns_per_m: 0,
    filter_mhz: 30_000,
    force_per_ampere: -50_000,
    max_current_ma: 32_000,
};

const DEFAULT: Gains = Gains {
    law: 1,
    kp_milli: 1000,
    kd_us: 20_000,
    ki_milli: 2000,
    damping_mns_per_m: 50_000,
    ..PAPER
};

fn config(gains: &Gains) -> CableConfig {
    let mut all = entries();
    for (key, value) in [
        (CableKey::TensionLaw, gains.law),
        (CableKey::TensionKp, gains.kp_milli),
        (CableKey::TensionKd, gains.kd_us),
        (CableKey::TensionKi, gains.ki_milli),
        (CableKey::TensionDamping, gains.damping_mns_per_m),
        (CableKey::TensionFilterMhz, gains.filter_mhz),
        (CableKey::ForcePerCurrent, gains.force_per_ampere),
        (CableKey::MaxCurrentMa, gains.max_current_ma),
    ] {
        let key = ConfigKey::cable(3, key);
        all.iter_mut().find(|e| e.key == key).unwrap().value = value;
    }
    build(&all).unwrap().cables[3]
}

/// The laws in SI units: Eq. 1 with the derivative of the measured tension, both behind a
/// first-order filter; the default law adds the plan's force, damping and an integral.
struct Reference {
    gains: Gains,
    filtered_n: f64,
    integral_n: f64,
    friction_n: f64,
    mass_kg: f64,
}

impl Reference {
    fn at(gains: Gains, tension_n: f64) -> Self {
        Self {
            gains,
            filtered_n: tension_n,
            integral_n: 0.0,
            friction_n: 0.5,
            mass_kg: 2.0,
        }
    }

    fn current_ma(&mut self, demand: &Demand) -> f64 {
        let g = &self.gains;
        let dt = 1e-3;
        let w_dt = std::f64::consts::TAU * f64::from(g.filter_mhz) * 1e-3 * dt;
        let before = self.filtered_n;
        let measured = f64::from(demand.measured_mn) * 1e-3;
        self.filtered_n += w_dt / (1.0 + w_dt) * (measured - before);
        let error = f64::from(demand.setpoint_mn) * 1e-3 - self.filtered_n;
        let error_rate = -(self.filtered_n - before) / dt;
        let mut force =
            f64::from(g.kp_milli) * 1e-3 * error + f64::from(g.kd_us) * 1e-6 * error_rate;
        if g.law == 1 {
            let planned = f64::from(demand.planned_speed_umps) * 1e-6;
            let fade = (planned / 500e-6).clamp(-1.0, 1.0);
            let drum = f64::from(demand.measured_speed_umps) * 1e-6;
            let moves = (drum / 4e-3).clamp(-1.0, 1.0);
            let sign = moves + fade * (1.0 - moves.abs());
            let too_fast = drum - planned;
            force += f64::from(demand.setpoint_mn) * 1e-3
                - self.friction_n * 205.0 / 256.0 * sign
                - self.mass_kg * f64::from(demand.planned_acceleration_umps2) * 1e-6
                + f64::from(g.damping_mns_per_m) * 1e-3 * too_fast;
            self.integral_n += f64::from(g.ki_milli) * 1e-3 * error * dt;
            force += self.integral_n;
        }
        force / (f64::from(g.force_per_ampere) * 1e-3) * 1e3
    }
}

/// A tension that drifts and jumps, and a plan that reverses.
fn recorded(rng: &mut Rng, tick: u32, last: &Demand) -> Demand {
    let measured = last.measured_mn + rng.between(-150, 150) as i32;
    let jump = tick.is_multiple_of(700);
    Demand {
        length: 4_500_000,
        setpoint_mn: 10_000 + (tick / 1000 * 500) as i32,
        measured_mn: if jump {
            rng.between(4000, 16_000) as i32
        } else {
            // Within floor and ceiling: outside of them another law is active.
            measured.clamp(1000, 30_000)
        },
        planned_speed_umps: (last.planned_speed_umps + rng.between(-200, 200) as i32)
            .clamp(-45_000, 45_000),
        planned_acceleration_umps2: rng.between(-200_000, 200_000) as i32,
        measured_speed_umps: last.planned_speed_umps + rng.between(-2000, 2000) as i32,
        stops: false,
        blind: false,
    }
}

fn worst_difference_ma(gains: &Gains, seed: u64) -> f64 {
    let config = config(gains);
    let mut rng = Rng(seed);
    let mut demand = Demand {
        setpoint_mn: 10_000,
        measured_mn: 10_000,
        ..Demand::default()
    };
    let mut core = TensionLoop::at(10_000);
    let mut reference = Reference::at(*gains, 10.0);
    let mut worst = 0.0_f64;
    for tick in 0..5000 {
        demand = recorded(&mut rng, tick, &demand);
        let current = f64::from(core.update(&config, &demand));
        assert!(!core.saturated);
        worst = worst.max((current - reference.current_ma(&demand)).abs());
    }
    worst
}

#[test]
fn eq_1_is_met_within_a_milliampere() {
    for seed in 0..4 {
        let worst = worst_difference_ma(&PAPER, seed);
        println!("PD law: {worst:.3} mA");
        assert!(worst <= 1.0, "{worst} mA");
    }
}

#[test]
fn the_default_law_is_met_within_a_milliampere() {
    for seed in 0..4 {
        let worst = worst_difference_ma(&DEFAULT, seed);
        println!("default law: {worst:.3} mA");
        assert!(worst <= 1.0, "{worst} mA");
    }
}

#[test]
fn a_slack_cable_is_reeled_in_at_the_reel_speed_and_comes_back_on_a_ramp() {
    let config = config(&DEFAULT);
    let mut core = TensionLoop::at(10_000);
    let demand = |measured_mn, measured_speed_umps| Demand {
        setpoint_mn: 10_000,
        measured_mn,
        measured_speed_umps,
        ..Demand::default()
    };
    for _ in 0..100 {
        core.update(&config, &demand(0, 0));
    }
    // At the reel speed of 10 mm/s only friction is left to overcome: 0.5 N at -50 N/A.
    assert_eq!(core.update(&config, &demand(0, -10_000)), -10);
    // At rest it pulls with 50 N s/m times 10 mm/s more; too fast, it brakes.
    assert_eq!(core.update(&config, &demand(0, 0)), -20);
    assert_eq!(core.update(&config, &demand(0, -30_000)), 10);
    // The cable is tight again at 1 N: from there the set-point takes 0.45 s.
    let force_mn = |ma: i32| -ma * 50;
    let first = force_mn(core.update(&config, &demand(10_000, 0)));
    assert!(first < 4000, "{first} mN at once");
    for _ in 0..600 {
        core.update(&config, &demand(10_000, 0));
    }
    let last = force_mn(core.update(&config, &demand(10_000, 0)));
    // The integral gained on the ramp is at most 2 /s times 10 N times 0.5 s / 2.
    assert!((last - 10_000).abs() < 6000, "{last} mN at the end");
}

#[test]
fn a_slack_cable_is_reeled_in_faster_than_its_plan_and_a_tight_one_paid_out_faster() {
    // Each planned speed, um/s, and the speeds wanted of a slack and of a tight cable: its reel speed is 10 mm/s.
    for (planned_speed_umps, slack_umps, tight_umps) in [
        (-26_000, -36_000, 10_000),
        (0, -10_000, 10_000),
        (26_000, -10_000, 36_000),
    ] {
        for (measured_mn, wanted_umps) in [(0, slack_umps), (36_000, tight_umps)] {
            let mut demand = Demand {
                setpoint_mn: 10_000,
                measured_mn,
                planned_speed_umps,
                ..Demand::default()
            };
            let config = speed_config(&DEFAULT);
            let fast = CableConfig {
                max_speed_umps: 100_000,
                ..config
            };
            let mut law = TensionLoop::at(measured_mn);
            assert_eq!(law.update_speed(&fast, &demand), wanted_umps);
            // By current: at the wanted speed only tension and friction are left, 0.5 N against the motion.
            demand.measured_speed_umps = wanted_umps;
            let mut law = TensionLoop::at(measured_mn);
            let force_mn = -50 * law.update(&self::config(&DEFAULT), &demand);
            let friction_mn = if measured_mn == 0 { 500 } else { -500 };
            assert_eq!(force_mn, measured_mn + friction_mn, "{planned_speed_umps}");
        }
    }
}

#[test]
fn c1_in_a_stop_a_cable_that_was_slack_is_needed_five_times_as_soon() {
    let config = config(&DEFAULT);
    let force_after = |stops: bool| {
        let mut core = TensionLoop::at(10_000);
        let demand = |measured_mn| Demand {
            setpoint_mn: 10_000,
            measured_mn,
            stops,
            ..Demand::default()
        };
        for _ in 0..100 {
            core.update(&config, &demand(0));
        }
        // Tight again at 1 N: 9 N are missing.
        for _ in 0..95 {
            core.update(&config, &demand(1000));
        }
        -50 * core.update(&config, &demand(1000))
    };
    let (before, stopping) = (force_after(false), force_after(true));
    assert!(before < 6000 && stopping > 15_000, "{before} {stopping} mN");
}

#[test]
fn s7_s8_s11_a_law_that_sees_nothing_goes_on_by_its_plan_and_damps() {
    let config = config(&DEFAULT);
    let mut core = TensionLoop::at(10_000);
    let steady = Demand {
        setpoint_mn: 10_000,
        measured_mn: 10_000,
        ..Demand::default()
    };
    for _ in 0..500 {
        core.update(&config, &steady);
    }
    // Only the set-point, independent of the reading: 10 N at -50 N/A.
    for measured_mn in [-3000, 0, 39_000] {
        let demand = Demand {
            measured_mn,
            blind: true,
            ..steady
        };
        assert_eq!(core.update(&config, &demand), -200);
    }
    // A drum that runs in by itself is held back: 50 N s/m times 20 mm/s, and its friction helps.
    let runs_in = Demand {
        measured_speed_umps: -20_000,
        blind: true,
        ..steady
    };
    let force_mn = -50 * core.update(&config, &runs_in);
    assert!((9000..10_000).contains(&force_mn), "{force_mn} mN");
}

#[test]
fn a_cable_over_the_ceiling_is_paid_out_at_the_reel_speed() {
    let config = config(&DEFAULT);
    let mut core = TensionLoop::at(36_000);
    let over = |measured_speed_umps| Demand {
        setpoint_mn: 10_000,
        measured_mn: 36_000,
        measured_speed_umps,
        ..Demand::default()
    };
    // 36 N against the cable, less the friction that the drum overcomes: 35.5 N at -50 N/A.
    assert_eq!(core.update(&config, &over(10_000)), -710);
    assert_eq!(core.update(&config, &over(0)), -700);
}

/// At its floor and at its ceiling a cable is held by the ordinary law, and a millinewton beyond by its drum's speed.
#[test]
fn the_law_changes_beyond_floor_and_ceiling_and_not_at_them() {
    let limits = config(&DEFAULT);
    let (floor_mn, ceiling_mn) = (limits.floor_mn, limits.ceiling_mn);
    for (measured_mn, leads) in [
        (floor_mn - 1, true),
        (floor_mn, false),
        (ceiling_mn, false),
        (ceiling_mn + 1, true),
    ] {
        let demand = Demand {
            setpoint_mn: 10_000,
            measured_mn,
            ..Demand::default()
        };
        // A drum at rest that is led is commanded its reel speed, whatever the gains are.
        let led_umps = if measured_mn > 10_000 {
            10_000
        } else {
            -10_000
        };
        let speed_umps =
            TensionLoop::at(measured_mn).update_speed(&speed_config(&DEFAULT), &demand);
        assert_eq!(speed_umps == led_umps, leads, "{measured_mn}: {speed_umps}");
        // And its force is what balances the cable, 0.5 N of friction, and 50 N s/m times 10 mm/s.
        let led_mn = measured_mn + if measured_mn > 10_000 { -1000 } else { 1000 };
        let force_mn = -50 * TensionLoop::at(measured_mn).update(&config(&DEFAULT), &demand);
        assert_eq!(
            (force_mn - led_mn).abs() <= 25,
            leads,
            "{measured_mn}: {force_mn}"
        );
    }
}

/// The noise of its sensor is below zero in every second tick: a free end must not be reeled in for it.
#[test]
fn a_cable_without_a_floor_is_never_slack() {
    for floor_mn in [0, 500] {
        let by_force = CableConfig {
            floor_mn,
            ..config(&DEFAULT)
        };
        let by_speed = CableConfig {
            floor_mn,
            ..speed_config(&DEFAULT)
        };
        for measured_mn in [-1, -300] {
            let demand = Demand {
                setpoint_mn: 3000,
                measured_mn,
                ..Demand::default()
            };
            let speed_umps = TensionLoop::at(measured_mn).update_speed(&by_speed, &demand);
            assert_eq!(speed_umps == -10_000, floor_mn > 0, "{speed_umps}");
            // 1 N of friction and damping is what would reel it in.
            let force_mn = -50 * TensionLoop::at(measured_mn).update(&by_force, &demand);
            let led = (force_mn - measured_mn - 1000).abs() <= 25;
            assert_eq!(led, floor_mn > 0, "{force_mn}");
        }
    }
}

#[test]
fn a_strong_gear_keeps_the_currents_resolution() {
    // 371:1 on a 20 mm drum: 900 N/A, and loads to match.
    let strong = Gains {
        force_per_ampere: 900_000,
        kp_milli: 900_000,
        ..PAPER
    };
    let worst = worst_difference_ma(&strong, 1);
    assert!(worst <= 1.0, "{worst} mA");
}

#[test]
fn a_slack_cable_is_pulled_and_the_sign_of_the_gear_is_respected() {
    for force_per_ampere in [-50_000, 50_000] {
        let config = config(&Gains {
            force_per_ampere,
            ..PAPER
        });
        let slack = Demand {
            setpoint_mn: 10_000,
            measured_mn: 5000,
            ..Demand::default()
        };
        let current = TensionLoop::at(5000).update(&config, &slack);
        // Kp 2.5 times 5 N is 12.5 N, at 50 N/A.
        assert_eq!(current, 250 * force_per_ampere.signum());
    }
}

#[test]
fn d4_the_current_is_cut_at_its_limit_in_both_directions_and_says_so() {
    let config = config(&Gains {
        max_current_ma: 100,
        ..PAPER
    });
    let mut core = TensionLoop::at(10_000);
    for (measured_mn, limit) in [(0, -100), (30_000, 100)] {
        let demand = Demand {
            setpoint_mn: 10_000,
            measured_mn,
            ..Demand::default()
        };
        for _ in 0..200 {
            core.update(&config, &demand);
        }
        assert_eq!(core.update(&config, &demand), limit);
        assert!(core.saturated);
    }
    let met = Demand {
        setpoint_mn: 10_000,
        measured_mn: 10_000,
        ..Demand::default()
    };
    for _ in 0..500 {
        core.update(&config, &met);
    }
    assert!(!core.saturated);
}

#[test]
fn the_integral_does_not_wind_up_against_the_limit() {
    let config = config(&Gains {
        max_current_ma: 300,
        kd_us: 0,
        ..DEFAULT
    });
    let mut core = TensionLoop::at(10_000);
    let starved = Demand {
        setpoint_mn: 12_000,
        measured_mn: 2000,
        ..Demand::default()
    };
    for _ in 0..10_000 {
        core.update(&config, &starved);
    }
    assert!(core.saturated);
    // Ten seconds of it, and the return takes no longer than the filter.
    let met = Demand {
        setpoint_mn: 12_000,
        measured_mn: 12_500,
        ..Demand::default()
    };
    let ticks = (0..1000).find(|_| {
        core.update(&config, &met);
        !core.saturated
    });
    assert!(ticks.unwrap() < 60, "{ticks:?}");
}

#[test]
fn a_wound_integral_unwinds_even_while_the_current_is_at_its_limit() {
    let config = config(&Gains {
        max_current_ma: 300,
        kp_milli: 0,
        kd_us: 0,
        damping_mns_per_m: 0,
        ..DEFAULT
    });
    let mut core = TensionLoop::at(10_000);
    // A little under the limit of 15 N: the integral fills up to 4.9 N.
    let short = Demand {
        setpoint_mn: 10_000,
        measured_mn: 9000,
        ..Demand::default()
    };
    while core.update(&config, &short) > -299 {}
    // The plan asks for more and gets too much: the integral must give way.
    let over = Demand {
        setpoint_mn: 12_000,
        measured_mn: 13_000,
        ..Demand::default()
    };
    let ticks = (0..5000).find(|_| {
        core.update(&config, &over);
        !core.saturated
    });
    // 1.9 N at 2 N/s per N of error.
    assert!(ticks.unwrap() < 1100, "{ticks:?}");
}

#[test]
fn nothing_overflows_at_the_ends_of_every_range() {
    let wild = Gains {
        law: 1,
        kp_milli: 1_000_000,
        kd_us: 10_000_000,
        ki_milli: 10_000_000,
        damping_mns_per_m: 100_000_000,
        filter_mhz: 400_000,
        force_per_ampere: 1,
        max_current_ma: 32_000,
    };
    let config = config(&wild);
    let mut core = TensionLoop::at(0);
    let mut rng = Rng(2);
    for tick in 0..5000 {
        let high = tick % 2 == 0;
        let demand = Demand {
            length: 4_500_000,
            setpoint_mn: if high { 10_000_000 } else { 0 },
            measured_mn: rng.between(-33_000_000, 33_000_000) as i32,
            planned_speed_umps: if high { i32::MAX } else { i32::MIN },
            planned_acceleration_umps2: if high { i32::MIN } else { i32::MAX },
            measured_speed_umps: if high { i32::MIN } else { i32::MAX },
            stops: high,
            blind: tick % 3 == 0,
        };
        assert!(core.update(&config, &demand).abs() <= 32_000);
    }
}

/// The same gains with a speed as output: 2.5 mm/s per N, 40 mm/s per N/s.
fn speed_config(gains: &Gains) -> CableConfig {
    CableConfig {
        output: mcdpr_firmware::config::TensionOutput::Speed,
        ..config(gains)
    }
}

//! Equilibrium, geometrico-static forward problem, linearisation.

use mcdpr_kinematics::*;
use nalgebra::Vector3;

const T4: [Option<f64>; 4] = [None, None, None, Some(10.0)];

fn hang(x: f64, y: f64, z: f64, t4: f64) -> Result<Equilibrium, Error> {
    four_cables().equilibrium_at(
        &Vector3::zeros(),
        &Vector3::new(x, y, z),
        &[None, None, None, Some(t4)],
        EquilibriumGuess::Cold,
        &StaticOptions::default(),
    )
}

#[test]
fn probe() {
    let robot = four_cables();
    let eq = hang(0.33, 0.0, -0.1, 10.0).unwrap();
    println!(
        "{:?} tilt {} {:?}",
        eq.pose,
        eq.pose.tilt_rad().to_degrees(),
        eq
    );
    println!("{:?}", robot.stability(&eq).unwrap().modes_hz);
    println!("{:?}", robot.linearise(&eq).unwrap().response);
    let mut ok = 0;
    let mut fail = [0; 4];
    let mut cold = 0;
    let mut warm = 0;
    let mut its = 0;
    for i in 0..12 {
        for j in 0..12 {
            for k in 0..6 {
                let (x, y, z) = (
                    0.08 + 0.04 * i as f64 + 0.013,
                    -0.3 + 0.055 * j as f64,
                    -0.05 - 0.09 * k as f64,
                );
                let _ = T4;
                match hang(x, y, z, 5.0) {
                    Ok(eq) => {
                        if !eq.stable {
                            fail[3] += 1;
                            continue;
                        }
                        ok += 1;
                        let held: [Held; 4] = core::array::from_fn(|i| {
                            if i == 3 {
                                Held::Tension(5.0)
                            } else {
                                Held::Length(eq.lengths_m[i])
                            }
                        });
                        match robot.geometrico_static(&held, Start::Cold, &Default::default()) {
                            Ok(f) => {
                                its += f.iterations;
                                if (f.pose.position_m - eq.pose.position_m).norm() < 1e-10 {
                                    cold += 1
                                } else {
                                    println!(
                                        "other {x} {y} {z}: {} {:?} {:?}",
                                        (f.pose.position_m - eq.pose.position_m).norm(),
                                        f.tensions_n,
                                        eq.tensions_n
                                    )
                                }
                            }
                            Err(e) => println!("cold {x} {y} {z}: {e}"),
                        }
                        let mut near = eq;
                        near.pose.position_m.x += 0.003;
                        match robot.geometrico_static(
                            &held,
                            Start::Warm(&near),
                            &Default::default(),
                        ) {
                            Ok(f) => {
                                if (f.pose.position_m - eq.pose.position_m).norm() < 1e-10
                                    && f.iterations < 16
                                {
                                    warm += 1
                                } else {
                                    println!(
                                        "warm {} {}",
                                        f.iterations,
                                        (f.pose.position_m - eq.pose.position_m).norm()
                                    )
                                }
                            }
                            Err(e) => println!("warm {x} {y} {z}: {e}"),
                        }
                    }
                    Err(Error::NegativeTension { .. }) => fail[0] += 1,
                    Err(Error::NotConverged { .. }) => fail[1] += 1,
                    Err(e) => {
                        println!("{e}");
                        fail[2] += 1
                    }
                }
            }
        }
    }
    println!("ok {ok} fail {fail:?} cold {cold} warm {warm} its {its}");
}

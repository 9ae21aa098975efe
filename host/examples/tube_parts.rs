use mcdpr::control::Handle;
use mcdpr::estimate::tube::{Belief, Doubts};
use mcdpr::machine::Mismatch;
use mcdpr::motion::Model;
use mcdpr::study::tube::audit;
use rayon::prelude::*;
fn main() {
    let robot = mcdpr::robot::find(&std::env::args().nth(1).unwrap()).unwrap();
    let plans: u64 = std::env::args().nth(2).unwrap().parse().unwrap();
    let model = Model::new(&robot).unwrap();
    let r = Mismatch::realistic();
    let none = Doubts { attachment_m: 0.0, length_m: 0.0, compliance: 0.0, gain: 0.0, zero_n: 0.0, loss: 0.0, mass: 0.0, center_m: 0.0, bandwidth: 0.0, late_s: 0.0, ..Doubts::within(0.0) };
    let d = Doubts::within(0.3e-3);
    let e = Mismatch::default();
    let parts: Vec<(&str, Mismatch, Doubts)> = vec![
        ("exact", e, none),
        ("exact+", e, Doubts{length_m: d.length_m, zero_n: d.zero_n, late_s: d.late_s, ..none}),
        ("anchors", Mismatch{anchors_m: r.anchors_m, ..e}, Doubts{anchor_m: d.anchor_m, ..none}),
        ("attach", Mismatch{attachments_m: r.attachments_m, ..e}, Doubts{attachment_m: d.attachment_m, ..none}),
        ("com", Mismatch{center_of_mass_m: r.center_of_mass_m, ..e}, Doubts{center_m: d.center_m, ..none}),
        ("mass", Mismatch{mass: r.mass, ..e}, Doubts{mass: d.mass, ..none}),
        ("ea", Mismatch{ea: r.ea, ..e}, Doubts{compliance: d.compliance, ..none}),
        ("gain", Mismatch{sensor_gain: r.sensor_gain, ..e}, Doubts{gain: d.gain, ..none}),
        ("bandwidth", Mismatch{bandwidth: r.bandwidth, ..e}, Doubts{bandwidth: d.bandwidth, ..none}),
        ("loss", Mismatch{pulley_loss: r.pulley_loss, ..e}, Doubts{loss: d.loss, ..none}),
        ("gears", Mismatch{gears: r.gears, ..e}, none),
        ("all", r, d),
    ];
    let controller = Default::default();
    for (name, machine, doubts) in parts { if let Some(only) = std::env::args().nth(3) { if only != name { continue; } }
        let belief = Belief::of(&robot, &doubts);
        let all: Vec<_> = (1..=plans).into_par_iter().filter_map(|seed| audit(&model, &belief, machine, seed, &controller, &Handle::new()).ok()).collect();
        let n = all.len() as f64;
        let rms = |f: &dyn Fn(&mcdpr::study::tube::Audit) -> f64| (all.iter().map(|a| f(a).powi(2)).sum::<f64>() / n).sqrt() * 1e3;
        let s: f64 = all.iter().map(|a| a.path_s).sum();
        println!("{name:10} {n:4} radius {:.3} error {:.3} max {:.3} inside {:.1}", rms(&|a| a.radius_mean_m), rms(&|a| a.error_mean_m), rms(&|a| a.error_max_m), 100.0*all.iter().map(|a| a.inside_s).sum::<f64>()/s);
    }
}

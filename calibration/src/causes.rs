//! Mistakes that explain data which fit no robot, found by trying them.
//!
//! A mistake is named where the data fit once it is undone, and fit with no other one: then it is the cause,
//! or cannot be told from it.

use super::answer::Answer;
use super::data::{Data, Tag, View};
use super::error::Refusal;

/// A mistake, in words, and the data without it.
type Cause = (String, Data);

/// The refusal that names the mistake, by this estimate; `None` where no mistake, or more than one, explains the data.
pub(crate) fn named(
    data: &Data,
    fit: &dyn Fn(&Data) -> Result<Answer, Refusal>,
) -> Option<Refusal> {
    let explains = |(words, undone): Cause| -> Option<(f64, String)> {
        let answer = fit(&undone).ok()?;
        let ratio = answer.chi_square? / answer.degrees_of_freedom?.max(1.0);
        let few = 50 * answer.rejected.len() < rows(data);
        (few && ratio < FITS).then_some((ratio, words))
    };
    let kinds: [fn(&Data) -> Vec<Cause>; 4] = [units, encoders, swapped_cables, tags];
    for kind in kinds {
        let mut found: Vec<(f64, String)> = kind(data).into_iter().filter_map(explains).collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        match found.as_slice() {
            [] => {}
            [(_, words)] => {
                return Some(Refusal::Contradiction {
                    what: format!("{words}: undone, the data fit; correct it and calibrate again"),
                });
            }
            [(_, one), (_, other), ..] => {
                return Some(Refusal::Contradiction {
                    what: format!("{one}, or {other}: with either undone the data fit"),
                });
            }
        }
    }
    None
}

/// Chi-square per degree of freedom below which data fit.
const FITS: f64 = 1.5;

fn rows(data: &Data) -> usize {
    let of = |pose: &super::data::Observation| {
        let lengths = pose.encoder_m.iter().flatten().count();
        lengths + pose.tension_n.as_ref().map_or(0, Vec::len) + 4 * pose.views.len()
    };
    data.poses.iter().map(of).sum()
}

fn changed(data: &Data, words: String, change: impl Fn(&mut super::data::Observation)) -> Cause {
    let mut out = data.clone();
    out.poses.iter_mut().for_each(change);
    (words, out)
}

fn units(data: &Data) -> Vec<Cause> {
    let lengths = [
        (1e3, "m"),
        (10.0, "cm"),
        (25.4, "inches"),
        (1e-3, "micrometres"),
    ];
    let lengths = lengths.map(|(factor, unit)| {
        let words = format!("the lengths are in {unit}, not in mm");
        changed(data, words, |pose| {
            pose.encoder_m
                .iter_mut()
                .flatten()
                .for_each(|l| *l *= factor);
        })
    });
    let tensions = [(9.81, "kgf"), (0.00981, "gf"), (4.448, "lbf"), (1e3, "kN")];
    let tensions = tensions.map(|(factor, unit)| {
        let words = format!("the tensions are in {unit}, not in N");
        changed(data, words, |pose| {
            pose.tension_n
                .iter_mut()
                .flatten()
                .for_each(|t| *t *= factor);
        })
    });
    let tensions = tensions.into_iter().filter(|_| data.has_statics());
    lengths.into_iter().chain(tensions).collect()
}

fn encoders(data: &Data) -> Vec<Cause> {
    let flip = |cable: Option<usize>| {
        let words = match cable {
            Some(i) => format!(
                "cable {}'s encoder counts backwards (encoder_sign of its winch)",
                i + 1
            ),
            None => "all encoders count backwards: lengths grow when cable is paid out".to_owned(),
        };
        changed(data, words, |pose| {
            for (i, length) in pose.encoder_m.iter_mut().enumerate() {
                if let Some(length) = length.as_mut().filter(|_| cable.is_none_or(|c| c == i)) {
                    *length = -*length;
                }
            }
        })
    };
    let each = (0..data.cable_count()).map(Some);
    each.chain([None]).map(flip).collect()
}

fn swapped_cables(data: &Data) -> Vec<Cause> {
    let mut out = Vec::new();
    for a in 0..data.cable_count() {
        for b in a + 1..data.cable_count() {
            let pair = format!("cables {} and {}", a + 1, b + 1);
            out.push(changed(data, format!("{pair} are swapped"), |pose| {
                pose.encoder_m.swap(a, b);
                if let Some(tensions) = &mut pose.tension_n {
                    tensions.swap(a, b);
                }
            }));
            let words = format!("the encoders of {pair} are swapped");
            out.push(changed(data, words, |pose| pose.encoder_m.swap(a, b)));
            if data.has_statics() {
                let words = format!("the tension sensors of {pair} are swapped");
                out.push(changed(data, words, |pose| {
                    if let Some(tensions) = &mut pose.tension_n {
                        tensions.swap(a, b);
                    }
                }));
            }
        }
    }
    out
}

/// A change of one view.
type Change = fn(&mut View);

/// Most tags of which pairs are tried: 66 pairs.
const TAGS: usize = 12;

/// Tags that are not where, or not how, the target's description has them.
fn tags(data: &Data) -> Vec<Cause> {
    let each = |words: String, change: &dyn Fn(&mut View)| {
        changed(data, words, |pose| pose.views.iter_mut().for_each(change))
    };
    // Corners read against their order, as of a mirrored print or picture.
    let mirror = |view: &mut View| view.corners_px = [1, 0, 3, 2].map(|k| view.corners_px[k]);
    let mut out = vec![each("all tags are mirrored".to_owned(), &mirror)];
    let seen = |tag: usize| {
        let mut views = data.poses.iter().flat_map(|pose| &pose.views);
        views.any(|view| view.tag == tag)
    };
    let ids: Vec<(usize, &Tag)> = data.tags.iter().enumerate().collect();
    let ids: Vec<_> = ids.into_iter().filter(|(tag, _)| seen(*tag)).collect();
    // A single tag that is turned shows as a turned frame: no contradiction.
    if ids.len() < 2 || ids.len() > TAGS {
        return out;
    }
    for &(tag, Tag { id, .. }) in &ids {
        let mine = |change: Change| {
            move |view: &mut View| {
                if view.tag == tag {
                    change(view);
                }
            }
        };
        let turns: [(&str, Change); 4] = [
            ("mirrored", |v| {
                v.corners_px = [1, 0, 3, 2].map(|k| v.corners_px[k])
            }),
            ("turned by a quarter", |v| v.corners_px.rotate_left(1)),
            ("turned by a half", |v| v.corners_px.rotate_left(2)),
            ("turned by three quarters", |v| v.corners_px.rotate_left(3)),
        ];
        for (how, turn) in turns {
            out.push(each(format!("tag {id} is {how}"), &mine(turn)));
        }
    }
    for (place, &(a, one)) in ids.iter().enumerate() {
        for &(b, other) in ids.iter().skip(place + 1) {
            let words = format!("tags {} and {} are swapped", one.id, other.id);
            out.push(each(words, &|view| {
                view.tag = match view.tag {
                    tag if tag == a => b,
                    tag if tag == b => a,
                    tag => tag,
                };
            }));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::joint::{Options, joint};
    use super::super::simulate::{Setup, Target, simulate};
    use super::*;

    /// The words of the refusal of data with a mistake.
    fn refused(target: Target, seed: u64, mistake: impl Fn(&mut Data)) -> String {
        let setup = Setup {
            target,
            seed,
            ..Setup::default()
        };
        let (mut data, _) = simulate(&setup).unwrap();
        mistake(&mut data);
        let options = Options {
            closer_looks: true,
            ..Options::default()
        };
        joint(&data, &options).unwrap_err().to_string()
    }

    fn each(data: &mut Data, change: impl Fn(&mut super::super::data::Observation)) {
        data.poses.iter_mut().for_each(change);
    }

    #[test]
    fn swapped_cables_reversed_encoders_and_wrong_units_are_named() {
        for seed in 1..=2 {
            let words = refused(Target::Board, seed, |data| {
                each(data, |pose| {
                    pose.encoder_m.swap(1, 2);
                    pose.tension_n.as_mut().unwrap().swap(1, 2);
                });
            });
            assert!(
                words.contains("cables 2 and 3 are swapped"),
                "{seed}: {words}"
            );
            let words = refused(Target::Board, seed, |data| {
                each(data, |pose| {
                    pose.encoder_m[3] = pose.encoder_m[3].map(|l| -l);
                });
            });
            assert!(
                words.contains("cable 4's encoder counts backwards"),
                "{seed}: {words}"
            );
            let words = refused(Target::Board, seed, |data| {
                each(data, |pose| {
                    pose.encoder_m.iter_mut().flatten().for_each(|l| *l /= 10.0);
                });
            });
            assert!(words.contains("in cm"), "{seed}: {words}");
        }
    }

    #[test]
    fn swapped_turned_and_mirrored_tags_are_named() {
        let views = |data: &mut Data, change: &dyn Fn(&mut View)| {
            each(data, |pose| pose.views.iter_mut().for_each(change));
        };
        let words = refused(Target::Board, 1, |data| {
            views(data, &|view| {
                view.tag = match view.tag {
                    0 => 1,
                    1 => 0,
                    tag => tag,
                }
            });
        });
        assert!(words.contains("tags 0 and 1 are swapped"), "{words}");
        let words = refused(Target::Board, 1, |data| {
            views(data, &|view| {
                if view.tag == 2 {
                    view.corners_px.rotate_left(2);
                }
            });
        });
        assert!(words.contains("tag 2 is turned by a half"), "{words}");
        let words = refused(Target::Board, 1, |data| {
            views(data, &|view| {
                view.corners_px = [1, 0, 3, 2].map(|k| view.corners_px[k]);
            });
        });
        assert!(words.contains("all tags are mirrored"), "{words}");
    }
}

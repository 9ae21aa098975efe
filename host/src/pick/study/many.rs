//! Many scenes, saved one by one, so that an interrupted study of hours can continue.

use super::{Knowledge, Line, SceneReport, Tally, Wanted, scene};
use crate::pick::PickError;
use crate::robot::Robot;
use mcdpr_simulator::camera::Order;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError, mpsc};

/// Many seeded scenes, two thirds of separate objects and one third of cluttered ones, 5 to 8
/// objects each. Scene `n` has seed `first_seed + n`.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Scenes with each knowledge of the machine.
    pub scenes: usize,
    /// The program's knowledge.
    pub knowledges: Vec<Knowledge>,
    /// Seed of the first scene.
    pub first_seed: u64,
    /// Whether the jaws turn about the tool's axis.
    pub turns: bool,
    /// Whether a chosen grasp is looked at again from nearby.
    pub near: bool,
    /// Whether the tray's floor is covered with printed tags for localisation.
    pub mat: bool,
    /// File to which each scene is added when it is done. Scenes that the same program has already
    /// added for the same robot and options are not picked again.
    pub keep: Option<PathBuf>,
}

/// One line of a kept file.
#[derive(Debug, Serialize, Deserialize)]
struct Kept {
    how: How,
    tally: Tally,
    /// The complete result, for later analysis.
    #[serde(default, skip_deserializing)]
    scene: Option<SceneReport>,
}

/// Conditions that a saved scene must share with the study.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct How {
    /// CRC-32 of the program's own file.
    program: u32,
    /// The robot's content hash.
    robot: u32,
    turns: bool,
    near: bool,
    mat: bool,
}

impl Study {
    /// Picks the scenes that are not saved yet, and sums all of them up. `progress` is called for
    /// every scene that was picked, with all that are done.
    ///
    /// # Errors
    /// [`PickError::Kept`] if the file cannot be read or written. A stopped scene is not an error.
    pub fn run(
        &self,
        robot: &Robot,
        mut progress: impl FnMut(&Tally, &[Tally]),
    ) -> Result<Vec<Line>, PickError> {
        let how = How {
            program: program_crc(),
            robot: robot.content_hash(),
            turns: self.turns,
            near: self.near,
            mat: self.mat,
        };
        let (mut file, mut done) = self.kept(&how)?;
        let mut jobs = self.jobs();
        let key = |seed, order, knowledge| (seed, order == Order::Cluttered, knowledge);
        done.retain(|tally| {
            let known = |job: &Wanted| key(job.seed, job.order, job.knowledge);
            let same = (tally.seed, tally.cluttered, tally.knowledge);
            let before = jobs.len();
            jobs.retain(|job| known(job) != same);
            jobs.len() < before
        });
        let jobs = Mutex::new(VecDeque::from(jobs));
        let (send, receive) = mpsc::channel();
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        std::thread::scope(|scope| {
            for _ in 0..threads {
                let (send, jobs) = (send.clone(), &jobs);
                scope.spawn(move || {
                    // Pictures are rendered by the scene's own thread: in a pool that all scenes
                    // share, a thread that waits for its picture would begin another whole scene.
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
                    loop {
                        let mut left = jobs.lock().unwrap_or_else(PoisonError::into_inner);
                        let Some(job) = left.pop_front() else { break };
                        // The lock ends before the scene, which takes minutes.
                        drop(left);
                        let pick = || scene(robot, &job);
                        let scene = pool.as_ref().map_or_else(|_| pick(), |p| p.install(pick));
                        if send.send((job, scene)).is_err() {
                            break;
                        }
                    }
                });
            }
            // The loop below ends when the last thread has dropped its own sender.
            drop(send);
            for (job, scene) in receive {
                let cluttered = job.order == Order::Cluttered;
                let tally = Tally::new(job.seed, cluttered, job.knowledge, &scene);
                let kept = Kept {
                    how: how.clone(),
                    tally: tally.clone(),
                    scene: scene.ok(),
                };
                let added = file.as_mut().map_or(Ok(()), |file| {
                    let mut line = serde_json::to_vec(&kept)?;
                    line.push(b'\n');
                    file.write_all(&line)
                });
                if let Err(error) = added {
                    // Running scenes are completed; no other begins.
                    jobs.lock().unwrap_or_else(PoisonError::into_inner).clear();
                    return Err(self.failed(&error));
                }
                done.push(tally);
                if let Some(tally) = done.last() {
                    progress(tally, &done);
                }
            }
            Ok(())
        })?;
        let mut lines = Vec::new();
        for &knowledge in &self.knowledges {
            for cluttered in [false, true] {
                lines.push(Line::of(&done, cluttered, knowledge));
            }
        }
        Ok(lines)
    }

    fn jobs(&self) -> Vec<Wanted> {
        let separate = self.scenes - self.scenes / 3;
        let job = |number: usize, knowledge: Knowledge| Wanted {
            order: if number < separate {
                Order::Separate
            } else {
                Order::Cluttered
            },
            count: 5 + number % 4,
            knowledge,
            seed: self.first_seed + number as u64,
            turns: self.turns,
            attempts_max: None,
            views: 1,
            near: self.near,
            paper: false,
            heavier: 1.0,
            tracked: false,
            mat: self.mat,
        };
        // Both arrangements alternate, so that a part of the study already covers both.
        let mut numbers: Vec<usize> = (0..self.scenes).collect();
        numbers.sort_by_key(|&number| {
            if number < separate {
                number
            } else {
                2 * (number - separate) + 1
            }
        });
        let all = |&knowledge: &Knowledge| numbers.iter().map(move |&n| (n, knowledge));
        let pairs = self.knowledges.iter().flat_map(all);
        pairs
            .map(|(number, knowledge)| job(number, knowledge))
            .collect()
    }

    /// The file to continue, and its scenes of this study.
    fn kept(&self, how: &How) -> Result<(Option<File>, Vec<Tally>), PickError> {
        let Some(path) = &self.keep else {
            return Ok((None, Vec::new()));
        };
        let opened = || {
            let mut options = OpenOptions::new();
            let mut file = options
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .open(path)?;
            let mut text = String::new();
            let read = (&mut file)
                .take(MOST_KEPT_BYTES)
                .read_to_string(&mut text)?;
            if read as u64 == MOST_KEPT_BYTES {
                return Err(std::io::Error::other(format!(
                    "it has {MOST_KEPT_BYTES} bytes or more"
                )));
            }
            // A line that was cut short by an interruption is removed; any other content is not
            // ours.
            let whole = text.rfind('\n').map_or(0, |at| at + 1);
            let cut = &text[whole..];
            if !cut.starts_with(LINE_BEGINS) && !LINE_BEGINS.starts_with(cut) {
                return Err(std::io::Error::other("its last line is not a kept scene"));
            }
            let mut tallies = Vec::new();
            for line in text[..whole].lines() {
                let kept: Kept = serde_json::from_str(line)?;
                if kept.how == *how {
                    tallies.push(kept.tally);
                }
            }
            file.set_len(whole as u64)?;
            file.seek(SeekFrom::End(0))?;
            Ok((Some(file), tallies))
        };
        opened().map_err(|error: std::io::Error| self.failed(&error))
    }

    fn failed(&self, error: &std::io::Error) -> PickError {
        let path = self.keep.clone().unwrap_or_default();
        PickError::Kept {
            file: path.display().to_string(),
            reason: error.to_string(),
        }
    }
}

/// Beginning of every line of a saved file, as [`Kept`] is written.
const LINE_BEGINS: &str = "{\"how\":";
/// Most bytes of a saved file: about 100,000 scenes.
const MOST_KEPT_BYTES: u64 = 1 << 30;

/// CRC-32 of the program's own file: another build may pick differently.
fn program_crc() -> u32 {
    let file = std::env::current_exe().and_then(std::fs::read);
    file.map_or(0, |bytes| mcdpr_protocol::frame::crc32(&bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pick::study::picking_robot;

    fn study(keep: &std::path::Path) -> Study {
        Study {
            scenes: 3,
            knowledges: vec![Knowledge::Exact],
            first_seed: 7,
            turns: true,
            near: true,
            mat: true,
            keep: Some(keep.to_owned()),
        }
    }

    #[test]
    fn two_thirds_are_separate_and_parts_of_it_tell_of_both() {
        let jobs = Study {
            scenes: 6,
            ..study(std::path::Path::new("none"))
        }
        .jobs();
        let orders: Vec<_> = jobs.iter().map(|job| (job.order, job.seed)).collect();
        let (s, c) = (Order::Separate, Order::Cluttered);
        assert_eq!(orders, [(s, 7), (s, 8), (c, 11), (s, 9), (s, 10), (c, 12)]);
    }

    #[test]
    fn kept_scenes_are_not_picked_again_and_a_torn_line_is() {
        let path = std::env::temp_dir().join(format!("mcdpr-kept-{}", std::process::id()));
        let _ = std::fs::remove_file(&path);
        let study = study(&path);
        let robot = picking_robot(&Robot::built_in("lab-fast").unwrap());
        let how = How {
            program: program_crc(),
            robot: robot.content_hash(),
            turns: true,
            near: true,
            mat: true,
        };
        let line = |seed: u64, how: &How| {
            let scene = Err(PickError::NoCamera { on: "chip".into() });
            let tally = Tally {
                attempts: 4,
                ..Tally::new(seed, false, Knowledge::Exact, &scene)
            };
            serde_json::to_string(&Kept {
                how: how.clone(),
                tally,
                scene: None,
            })
            .unwrap()
        };
        let other = How {
            program: how.program ^ 1,
            ..how.clone()
        };
        let whole = format!("{}\n{}\n", line(7, &how), line(8, &other));
        std::fs::write(&path, format!("{whole}{}", &line(8, &how)[..40])).unwrap();
        let (file, tallies) = study.kept(&how).unwrap();
        assert!(file.is_some());
        assert_eq!(tallies.len(), 1);
        assert_eq!((tallies[0].seed, tallies[0].attempts), (7, 4));
        assert_eq!(std::fs::read_to_string(&path).unwrap(), whole);
        // A file of another kind is refused, and not changed.
        for other in ["no study\n", "no study", "{\"a\": 1}"] {
            std::fs::write(&path, other).unwrap();
            let error = study.kept(&how).unwrap_err().to_string();
            assert!(error.contains("mcdpr-kept"), "{error}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), other);
        }
        std::fs::remove_file(&path).unwrap();
    }
}

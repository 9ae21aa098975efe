//! A simulated scene in which the power fails, and picking continues.

use super::{SceneReport, Stage, Wanted};
use crate::control::Handle;
use crate::machine::Controller;
use crate::pick::{Arm, PickError, Picker};
use crate::record::EventBus;
use crate::record::events::{Patience, Watched};
use crate::recovery::simulated::AfterCut;
use crate::recovery::{About, JournalWriter, MemoryDisk, Verdict};
use crate::robot::Robot;
use crate::run::RunError;
use crate::run::saved::scale_of;
use crate::scenario::{FaultyLink, Injection, Supply};
use crate::sight::SightError;
use mcdpr_protocol::SessionId;
use mcdpr_vision::grasp::Detector;

/// Board and robot come to rest after the power is back, µs.
const SETTLE_US: u64 = 5_000_000;
/// A cut without a stated end lasts so long, s.
const LASTS_S: f64 = 1.0;
/// Bound of the tool's position that picking needs, m: the mat corrects more.
const BOUND_M: f64 = 5e-3;
/// Checksum of the simulated task: any number, as both ends are here.
const HASH: u32 = 1;

/// Picks one scene until a supply fails, recovers the position without a camera (in the simulator nobody
/// touches the robot), and continues. Returns the scene with the report of the continuation, and the
/// verdict of the recovery.
///
/// # Errors
/// As [`super::scene`]; [`PickError::NotCut`] where picking was over before, [`PickError::NotRecovered`]
/// where the recovery refuses.
pub(crate) fn scene_after_cut(
    robot: &Robot,
    wanted: &Wanted,
    detector: &mut dyn Detector,
    handle: &Handle,
    controller: &Controller,
    cut: &Injection,
) -> Result<(SceneReport, Verdict), PickError> {
    let failed = |what: String| PickError::from(RunError::Sight(SightError::Simulation { what }));
    let mut stage = Stage::new(robot, wanted, controller)?;
    let lasts_s = cut.lasts_s.unwrap_or(LASTS_S);
    let injection = Injection {
        lasts_s: Some(lasts_s),
        ..*cut
    };
    let faulty = FaultyLink::new(stage.link.clone(), &[injection]);
    let disk = MemoryDisk::default();
    let mine = disk.clone();
    let about = About {
        session: 1,
        robot: stage.model.robot().name.clone(),
        scale: scale_of(stage.model.robot()),
        task: "pick".to_owned(),
        task_hash: HASH,
    };
    let mut events = EventBus::default();
    let writer = JournalWriter::new(about, move |_: &str| Ok(mine.clone()));
    let added = events.add(writer, Patience::Wait);
    added.map_err(|error| failed(error.to_string()))?;
    let line = Watched::new(faulty.clone(), &events);
    let interrupted =
        Arm::start(stage.model.clone(), line, SessionId(1), handle).and_then(|mut arm| {
            Picker::new(&mut arm, &mut stage.eye, detector, &stage.options).run(&mut stage.observer)
        });
    events.finish();
    match interrupted {
        Err(PickError::Run(RunError::Interrupted)) => return Err(RunError::Interrupted.into()),
        // A board that starts again has no lengths: the program may stop at that, not at the line.
        Err(_) if !faulty.injected_ms().is_empty() => {}
        Err(error) => return Err(error),
        Ok(_) => return Err(PickError::NotCut),
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "some seconds"
    )]
    let settle_us = (lasts_s * 1e6) as u64 + SETTLE_US;
    faulty
        .settle(settle_us)
        .map_err(|error| failed(error.to_string()))?;
    let alive = matches!(
        cut.supply,
        Some(Supply::Board | Supply::Drives | Supply::Dip | Supply::Crash)
    );
    let mut after = AfterCut::of(stage.link.clone(), &disk, alive, wanted.seed)?;
    after.together = cut.supply == Some(Supply::All);
    // Far ahead: a journal of this very moment is never from the future.
    let journal = after.read(&stage.model, u64::MAX / 2);
    let (verdict, _) = after.recover(&stage.model, journal.clone(), false, true, BOUND_M)?;
    if !verdict.accepted {
        return Err(PickError::NotRecovered {
            sentence: verdict.sentence,
            next: verdict.next,
        });
    }
    let line = stage.link.clone();
    let session = SessionId(4);
    let journal = |_: &str| journal;
    let resumed = Arm::resume(stage.model.clone(), line, session, handle, HASH, journal);
    let (mut arm, was_closed) = resumed?;
    stage.observer.continue_with_another();
    let report = Picker::new(&mut arm, &mut stage.eye, detector, &stage.options)
        .resume(was_closed, &mut stage.observer)?;
    arm.finish()?;
    Ok((stage.ended(report, None), verdict))
}

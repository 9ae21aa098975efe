//! A real camera on a separate thread: the thread that feeds a board must not wait for a picture.

use super::{SightError, TagSource, TagView};
use mcdpr_vision::tag::{Options, detect};
use mcdpr_vision::{Cameras, Frame, RgbImage, Source, SourceError};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};

/// A request to the camera's thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Want {
    Frame,
    Color,
}

/// Its answer.
enum Taken {
    Frame(Result<Box<Frame>, SourceError>),
    Color(Result<RgbImage, SourceError>),
}

/// A source of pictures that works on another thread. It ends with this.
pub struct Camera {
    name: String,
    cameras: Cameras,
    asks: Sender<Want>,
    answers: Receiver<Taken>,
    /// Requests in progress.
    asked: Option<Want>,
}

impl Camera {
    /// Opens a source on a new thread.
    ///
    /// # Errors
    /// Those of `open`; if there are no more threads.
    pub fn start<S: Source>(
        open: impl FnOnce() -> Result<S, SourceError> + Send + 'static,
    ) -> Result<Self, SourceError> {
        let (asks, wants) = channel();
        let (send, answers) = channel();
        let (sender, opened) = channel();
        let work = move || {
            let mut source = match open() {
                Ok(source) => {
                    let _ = sender.send(Ok((source.name(), source.cameras())));
                    source
                }
                Err(error) => {
                    let _ = sender.send(Err(error));
                    return;
                }
            };
            for want in wants {
                let taken = match want {
                    Want::Frame => Taken::Frame(source.frame().map(Box::new)),
                    Want::Color => Taken::Color(source.color()),
                };
                if send.send(taken).is_err() {
                    return;
                }
            }
        };
        begin("camera", work)?;
        let (name, cameras) = opened.recv().map_err(|_| gone("it ended at once"))??;
        Ok(Self {
            name,
            cameras,
            asks,
            answers,
            asked: None,
        })
    }

    /// Requests what is not in progress yet, and takes what has arrived.
    fn poll(&mut self, want: Want) -> Option<Result<Taken, SourceError>> {
        // One request at a time: a queue would deliver old pictures.
        if self.asked.is_none() {
            if self.asks.send(want).is_err() {
                return Some(Err(gone("its thread ended")));
            }
            self.asked = Some(want);
        }
        match self.answers.try_recv() {
            Ok(taken) => {
                // A picture that was requested before and is no longer wanted.
                let wanted = self.asked.take() == Some(want);
                wanted.then_some(Ok(taken))
            }
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(Err(gone("its thread ended"))),
        }
    }

    /// Waits for the result of [`Camera::poll`].
    fn wait(&mut self, want: Want) -> Result<Taken, SourceError> {
        loop {
            if let Some(taken) = self.poll(want) {
                return taken;
            }
            if self.asked.is_none() {
                continue;
            }
            let Ok(taken) = self.answers.recv() else {
                return Err(gone("its thread ended"));
            };
            if self.asked.take() == Some(want) {
                return Ok(taken);
            }
        }
    }
}

/// Work on a separate thread, which ends when there are no more requests.
fn begin(name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), SourceError> {
    let thread = std::thread::Builder::new().name(name.to_owned());
    let begun = thread.spawn(work);
    begun.map(drop).map_err(|error| gone(&error.to_string()))
}

fn gone(reason: &str) -> SourceError {
    SourceError::Device {
        name: "on its thread".to_owned(),
        reason: reason.to_owned(),
    }
}

fn frame_of(taken: Result<Taken, SourceError>) -> Result<Frame, SourceError> {
    match taken? {
        Taken::Frame(frame) => frame.map(|frame| *frame),
        Taken::Color(_) => Err(gone("it gave a colour picture for a frame")),
    }
}

fn color_of(taken: Result<Taken, SourceError>) -> Result<RgbImage, SourceError> {
    match taken? {
        Taken::Color(color) => color,
        Taken::Frame(frame) => frame.map(|frame| frame.color),
    }
}

impl Source for Camera {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn cameras(&self) -> Cameras {
        self.cameras
    }

    fn frame(&mut self) -> Result<Frame, SourceError> {
        let taken = self.wait(Want::Frame);
        frame_of(taken)
    }

    fn color(&mut self) -> Result<RgbImage, SourceError> {
        let taken = self.wait(Want::Color);
        color_of(taken)
    }

    fn poll_frame(&mut self) -> Option<Result<Frame, SourceError>> {
        self.poll(Want::Frame).map(frame_of)
    }

    fn poll_color(&mut self) -> Option<Result<RgbImage, SourceError>> {
        self.poll(Want::Color).map(color_of)
    }
}

/// The tags in a camera's pictures, found on a separate thread.
pub(crate) struct CameraTags {
    asks: Sender<()>,
    answers: Receiver<Result<Vec<TagView>, SightError>>,
    asked: bool,
}

impl CameraTags {
    /// The tags with these numbers in the pictures of a camera, whose lens is `lens`. `show` gets every picture
    /// with the tags in it.
    ///
    /// # Errors
    /// If there are no more threads.
    pub fn start(
        mut camera: Camera,
        lens: mcdpr_vision::Camera,
        ids: Vec<u32>,
        mut show: impl FnMut(&RgbImage, &[TagView]) + Send + 'static,
    ) -> Result<Self, SourceError> {
        let (asks, wants) = channel();
        let (send, answers) = channel();
        let work = move || {
            while wants.recv().is_ok() {
                let seen = tags(camera.color(), &lens, &ids, &mut show);
                if send.send(seen).is_err() {
                    return;
                }
            }
        };
        begin("tags", work)?;
        Ok(Self {
            asks,
            answers,
            asked: false,
        })
    }

    fn ask(&mut self) {
        if !self.asked {
            // A thread that has ended gives no answer.
            let _ = self.asks.send(());
            self.asked = true;
        }
    }
}

impl TagSource for CameraTags {
    fn look(&mut self) -> Result<Vec<TagView>, SightError> {
        self.ask();
        self.asked = false;
        self.answers
            .recv()
            .unwrap_or_else(|_| Err(no_picture(&"its thread ended")))
    }

    fn poll(&mut self) -> Option<Result<Vec<TagView>, SightError>> {
        self.ask();
        let answer = match self.answers.try_recv() {
            Ok(answer) => answer,
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => Err(no_picture(&"its thread ended")),
        };
        self.asked = false;
        Some(answer)
    }
}

fn no_picture(reason: &dyn std::fmt::Display) -> SightError {
    SightError::NoPicture {
        what: reason.to_string(),
    }
}

fn tags(
    picture: Result<RgbImage, SourceError>,
    lens: &mcdpr_vision::Camera,
    ids: &[u32],
    show: &mut impl FnMut(&RgbImage, &[TagView]),
) -> Result<Vec<TagView>, SightError> {
    let picture = picture.map_err(|error| no_picture(&error))?;
    let size = [picture.width(), picture.height()];
    if size == lens.size_px {
        let found = views(&picture, lens, ids, 0);
        show(&picture, &found);
        return Ok(found);
    }
    let [width, height] = lens.size_px;
    Err(no_picture(&format!(
        "its pictures are {} x {} px, the robot file's camera has {width} x {height}",
        size[0], size[1]
    )))
}

/// The tags with these numbers in a picture, in the order of their numbers.
pub(super) fn views(
    picture: &RgbImage,
    lens: &mcdpr_vision::Camera,
    ids: &[u32],
    image_time_us: u64,
) -> Vec<TagView> {
    let found = detect(&picture.to_gray(), Some(lens), &Options::default());
    let wanted = found.into_iter().filter(|tag| ids.contains(&tag.id));
    let mut views: Vec<TagView> = wanted
        .map(|tag| TagView {
            id: tag.id,
            corners_px: tag.corners_px.map(Into::into),
            covariance_px2: tag
                .covariance_px2
                .map(|c| [[c[(0, 0)], c[(0, 1)]], [c[(1, 0)], c[(1, 1)]]]),
            image_time_us,
        })
        .collect();
    views.sort_by_key(|view| view.id);
    views
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts up, and has no third frame.
    struct Counting(u8);

    impl Source for Counting {
        fn name(&self) -> String {
            "counting".to_owned()
        }
        fn cameras(&self) -> Cameras {
            let camera = mcdpr_vision::Camera {
                size_px: [2, 2],
                focal_px: [2.0; 2],
                center_px: [1.0; 2],
                distortion: [0.0; 5],
            };
            Cameras {
                color: camera,
                depth: camera,
                color_from_depth: nalgebra::Isometry3::identity(),
            }
        }
        fn frame(&mut self) -> Result<Frame, SourceError> {
            Err(gone("no distances"))
        }
        fn color(&mut self) -> Result<RgbImage, SourceError> {
            self.0 += 1;
            Ok(RgbImage::filled(2, 2, [self.0; 3]))
        }
    }

    #[test]
    fn pictures_come_from_the_thread_one_for_each_question() {
        let mut camera = Camera::start(|| Ok(Counting(0))).unwrap();
        assert_eq!(camera.name(), "counting");
        let first = loop {
            if let Some(picture) = camera.poll_color() {
                break picture.unwrap();
            }
        };
        assert_eq!(first.pixels()[0], [1; 3]);
        assert_eq!(camera.color().unwrap().pixels()[0], [2; 3]);
        // A picture in progress that is no longer wanted is not taken for another one.
        let _ = camera.poll_frame();
        assert_eq!(camera.color().unwrap().pixels()[0], [3; 3]);
        let error = camera.frame().unwrap_err().to_string();
        assert!(error.contains("no distances"), "{error}");
    }

    #[test]
    fn a_camera_that_can_not_be_opened_says_why() {
        let opened = Camera::start(|| Err::<Counting, _>(gone("no such device")));
        let error = opened
            .err()
            .map(|error| error.to_string())
            .unwrap_or_default();
        assert!(error.contains("no such device"), "{error}");
    }
}

//! Questions whose answer has one form: another one is an error, never a default.

use super::Client;
use crate::faults::request_name;
use crate::link::Link;
use crate::link::error::ClientError;
use mcdpr_protocol::{Bench, BenchTest, Info, Kept, Reply, Request, Status, Winch};

impl<L: Link> Client<L> {
    /// The board's state.
    ///
    /// # Errors
    /// [`ClientError::Answer`] where the board answers something else, and those of [`Self::request`].
    pub(crate) fn ask_status(&mut self) -> Result<Status, ClientError> {
        self.asked(Request::Status, |reply| match reply {
            Reply::Status(status) => Some(status),
            _ => None,
        })
    }

    /// What one winch reads, cables counted from 1.
    ///
    /// # Errors
    /// [`ClientError::Answer`] where the board answers something else, and those of [`Self::request`].
    pub fn winch(&mut self, cable: u8) -> Result<Winch, ClientError> {
        self.asked(Request::Winch { cable }, |reply| match reply {
            Reply::Winch(winch) => Some(winch),
            _ => None,
        })
    }

    /// Does one step of the board's test.
    ///
    /// # Errors
    /// [`ClientError::Answer`] where the board answers something else, and those of [`Self::request`].
    pub fn bench(&mut self, test: BenchTest) -> Result<Bench, ClientError> {
        self.asked(Request::Bench { test }, |reply| match reply {
            Reply::Bench(report) => Some(report),
            _ => None,
        })
    }

    /// The lengths that the board kept over its last reset.
    ///
    /// # Errors
    /// [`ClientError::Answer`] where the board answers something else, and those of [`Self::request`].
    pub fn kept(&mut self) -> Result<Kept, ClientError> {
        self.asked(Request::Kept, |reply| match reply {
            Reply::Kept(kept) => Some(kept),
            _ => None,
        })
    }

    /// What the board is.
    ///
    /// # Errors
    /// [`ClientError::Answer`] where the board answers something else, and those of [`Self::request`].
    pub(super) fn ask_info(&mut self) -> Result<Info, ClientError> {
        self.asked(Request::Info, |reply| match reply {
            Reply::Info(info) => Some(info),
            _ => None,
        })
    }

    fn asked<T>(
        &mut self,
        request: Request,
        of: impl FnOnce(Reply) -> Option<T>,
    ) -> Result<T, ClientError> {
        let name = request_name(&request);
        let reply = self.request(request)?;
        of(reply).ok_or(ClientError::Answer { request: name })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::LinkError;
    use mcdpr_protocol::frame::MAX_FRAME;
    use mcdpr_protocol::message::{decode_command, encode_answer};
    use mcdpr_protocol::{Answer, Channel, Deframer, Hello, ResetCause, SessionId};

    /// A board that says `Done` to everything.
    #[derive(Default)]
    struct Agreeing {
        now_us: u64,
        deframer: Deframer,
        answers: Vec<u8>,
    }

    impl Link for Agreeing {
        fn now_us(&self) -> u64 {
            self.now_us
        }

        fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
            for byte in bytes {
                let Some(Ok(frame)) = self.deframer.push(*byte) else {
                    continue;
                };
                assert_eq!(frame.0, Channel::Command);
                let sequence = decode_command(frame.1).unwrap().sequence;
                let mut out = [0; MAX_FRAME];
                let result = Ok(Reply::Done);
                let used = encode_answer(&Answer { sequence, result }, &mut out).unwrap();
                self.answers.extend_from_slice(&out[..used]);
            }
            Ok(())
        }

        fn receive(&mut self, _until_us: u64, into: &mut Vec<u8>) -> Result<u64, LinkError> {
            self.now_us += 1000;
            into.append(&mut self.answers);
            Ok(self.now_us)
        }
    }

    #[test]
    fn an_answer_of_another_form_is_an_error_with_the_name_of_the_question() {
        let hello = Hello {
            major: 0,
            minor: 0,
            board_id: [0; 12],
            git_hash: [0; 8],
            reset_cause: ResetCause::Power,
        };
        let mut client = Client::idle(Agreeing::default(), SessionId(1), hello);
        let said = [
            client.ask_status().map(|_| ()),
            client.winch(1).map(|_| ()),
            client.bench(BenchTest::Look).map(|_| ()),
            client.kept().map(|_| ()),
            client.ask_info().map(|_| ()),
        ];
        let names: Vec<String> = (said.into_iter())
            .map(|said| match said {
                Err(ClientError::Answer { request }) => request,
                other => panic!("{other:?}"),
            })
            .collect();
        let mut different = names.clone();
        different.sort();
        different.dedup();
        assert_eq!(different.len(), names.len(), "{names:?}");
    }
}

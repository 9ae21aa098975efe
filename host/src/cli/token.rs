//! The token of the live page: from a file, from the environment, or from the command line.

use super::Failed;
use std::path::{Path, PathBuf};

/// The variable of the environment that holds a token.
const VARIABLE: &str = "MCDPR_TOKEN";
/// Most bytes of a token's file.
const MOST_BYTES: u64 = 4096;

/// Source of the token for orders. Without any, a random one is made.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct Token {
    /// File that contains the token for orders, readable only by its owner; else the environment's
    /// MCDPR_TOKEN, else a random one is made
    #[arg(long, value_name = "FILE", conflicts_with = "token")]
    token_file: Option<PathBuf>,
    /// Token for orders. Other users of this machine can see it in the list of processes: prefer
    /// --token-file
    #[arg(long, value_name = "TEXT")]
    token: Option<String>,
}

impl Token {
    /// The token, if one is given.
    ///
    /// # Errors
    /// If the file cannot be read, is readable by others, or the token is empty.
    pub(crate) fn chosen(&self) -> Result<Option<String>, Failed> {
        let (what, token) = if let Some(path) = &self.token_file {
            ("--token-file", Some(read(path)?))
        } else if let Some(token) = &self.token {
            ("--token", Some(token.clone()))
        } else {
            (VARIABLE, std::env::var(VARIABLE).ok())
        };
        let token = token.map(|token| token.trim().to_owned());
        if token.as_ref().is_some_and(String::is_empty) {
            let reason = "the token is empty: anybody could give orders";
            return Err(Failed::from_error(what)(reason));
        }
        Ok(token)
    }
}

fn read(path: &Path) -> Result<String, Failed> {
    let what = format!("--token-file {}", path.display());
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        let found = std::fs::metadata(path).map_err(Failed::from_error(&what))?;
        if found.permissions().mode() & 0o077 != 0 {
            let reason = format!("others may read it: chmod 600 {}", path.display());
            return Err(Failed::from_error(&what)(reason));
        }
    }
    crate::files::read_text_to(path, MOST_BYTES).map_err(Failed::from_error(&what))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_token_is_refused_and_a_file_must_be_its_owners_alone() {
        let given = |token: &str| Token {
            token: Some(token.to_owned()),
            token_file: None,
        };
        assert_eq!(given(" abc ").chosen().unwrap().as_deref(), Some("abc"));
        for empty in ["", "   "] {
            let error = given(empty).chosen().unwrap_err().to_string();
            assert!(error.contains("empty"), "{error}");
        }
        let path = std::env::temp_dir().join(format!("mcdpr-token-{}", std::process::id()));
        let file = Token {
            token: None,
            token_file: Some(path.clone()),
        };
        assert!(file.chosen().is_err());
        std::fs::write(&path, "secret\n").unwrap();
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt as _;
            let mode = |mode| {
                std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
            };
            mode(0o644);
            let error = file.chosen().unwrap_err().to_string();
            assert!(error.contains("chmod 600"), "{error}");
            mode(0o600);
        }
        assert_eq!(file.chosen().unwrap().as_deref(), Some("secret"));
        std::fs::write(&path, "\n").unwrap();
        assert!(file.chosen().is_err());
        std::fs::remove_file(path).unwrap();
    }
}

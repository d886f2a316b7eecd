//! One picture for a browser without scripts: it sends the token of the address in a form, and gets what the walk shows.

use std::net::IpAddr;
use std::sync::Arc;

use axum::body::{Bytes, to_bytes};
use axum::extract::{Extension, Request, State};
use axum::http::header::{CONTENT_SECURITY_POLICY, HOST};
use axum::http::{HeaderValue, StatusCode};
use axum::response::Response;
use foveal_engine::thread::Shown;
use tokio::sync::oneshot;

use super::Message;
use super::listen::{Counted, Door, answer, header, refused};
use crate::coding::{Coding, encode};
use crate::hub::Without;
use crate::page;

/// Most bytes of a form: `t=`, and the longest token.
const FORM_MAX: usize = 256;
const TEXT: &str = "text/plain; charset=utf-8";

/// Who wants to see one picture.
#[derive(Debug)]
pub(super) struct Asked {
    pub address: IpAddr,
    pub token: String,
    pub answer: oneshot::Sender<Result<Arc<Shown>, Without>>,
}

/// The picture on show, each bit of it, for who has a token. Pages from elsewhere may send the form, too: they gain nothing by
/// it, as they see no answer, and a browser has no cookie that would stand for the token.
pub(super) async fn still(
    State(door): State<Arc<Door>>,
    Extension(counted): Extension<Arc<Counted>>,
    request: Request,
) -> Response {
    let (head, body) = request.into_parts();
    if !door.hosts.knows(header(&head.headers, HOST)) {
        return refused("this name is not served; --host allows it\n");
    }
    let token = to_bytes(body, FORM_MAX).await.ok().as_ref().and_then(token);
    let Some(token) = token else { return answer(StatusCode::BAD_REQUEST, TEXT, "no form of this page\n") };
    let address = door.speaks_for(&head.headers, counted.address);
    let (sender, shown) = oneshot::channel();
    if door.hub.send(Message::Still(Asked { address, token, answer: sender })).await.is_err() {
        return answer(StatusCode::SERVICE_UNAVAILABLE, TEXT, "the server ends\n");
    }
    let shown = match shown.await {
        Ok(Ok(shown)) => shown,
        Ok(Err(Without::Token)) => return refused("that is not the token of the address\n"),
        Ok(Err(Without::Picture)) | Err(_) => {
            return answer(StatusCode::SERVICE_UNAVAILABLE, TEXT, "there is no picture yet; try again\n");
        }
    };
    let coded = tokio::task::spawn_blocking(move || encode(&shown.picture, None, Coding::Lossless)).await;
    match coded {
        Ok(Some(coded)) => {
            let mut response = answer(StatusCode::OK, "image/webp", coded.bytes);
            let policy = HeaderValue::from_static(page::PICTURE_POLICY);
            response.headers_mut().insert(CONTENT_SECURITY_POLICY, policy);
            response
        }
        _ => answer(StatusCode::INTERNAL_SERVER_ERROR, TEXT, "the picture cannot be coded\n"),
    }
}

/// The token of a form. Tokens need no escapes; people copy what stands before them, too.
fn token(form: &Bytes) -> Option<String> {
    let text = std::str::from_utf8(form).ok()?.strip_prefix("t=")?;
    let text = text.trim_start_matches("%23").trim_start_matches("t%3D");
    Some(text.trim_end_matches("%0D%0A").to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_found_in_forms() {
        let token = |form: &'static str| token(&Bytes::from_static(form.as_bytes()));
        for form in ["t=Ab-_9", "t=%23t%3DAb-_9", "t=t%3DAb-_9"] {
            assert_eq!(token(form).as_deref(), Some("Ab-_9"), "{form}");
        }
        assert_eq!((token(""), token("u=1")), (None, None));
    }
}

// Converts an error to a reply.
#pragma once

#include "base/result.h"
#include "link/proto_text.h"
#include "ruffini.pb.h"

namespace ruffini {

inline ruffini_ReplyCode reply_code(ErrorKind kind) {
  switch (kind) {
    case ErrorKind::kBadInput:
      return ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
    case ErrorKind::kUnavailable:
      return ruffini_ReplyCode_REPLY_NOT_READY;
    case ErrorKind::kRefused:
      return ruffini_ReplyCode_REPLY_REFUSED;
    case ErrorKind::kStorage:
      return ruffini_ReplyCode_REPLY_STORAGE;
    case ErrorKind::kBusy:
      return ruffini_ReplyCode_REPLY_BUSY;
  }
  return ruffini_ReplyCode_REPLY_BAD_ARGUMENT;
}

inline void fill_reply(ruffini_Reply& reply, const Status& status) {
  if (status) return;
  reply.code = reply_code(status.error().kind);
  copy_text(reply.text, status.error().message);
}

}  // namespace ruffini

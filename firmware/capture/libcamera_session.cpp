#include "capture/libcamera_session.h"

namespace ruffini {

std::shared_ptr<libcamera::CameraManager> camera_manager() {
  static std::weak_ptr<libcamera::CameraManager> in_use;
  if (auto manager = in_use.lock()) return manager;
  const std::shared_ptr<libcamera::CameraManager> manager(new libcamera::CameraManager,
                                                          [](libcamera::CameraManager* one) {
                                                            one->stop();
                                                            delete one;
                                                          });
  if (manager->start() != 0) return nullptr;
  in_use = manager;
  return manager;
}

void LibcameraSession::complete(libcamera::Request* request) {
  if (request->status() == libcamera::Request::RequestCancelled) return;
  const std::lock_guard lock(mutex);
  if (n_done < done.size()) done[n_done++] = request;
  changed.notify_one();
}

void LibcameraSession::disconnect() {
  const std::lock_guard lock(mutex);
  is_gone = true;
  changed.notify_one();
}

void LibcameraSession::free_buffers() {
  requests.clear();
  mappings.clear();
  own_buffers.clear();
  allocator.reset();
}

LibcameraSession::~LibcameraSession() {
  free_buffers();
  if (!camera) return;
  camera->requestCompleted.disconnect();
  camera->disconnected.disconnect();
  if (is_acquired) camera->release();
  camera.reset();
}

}  // namespace ruffini

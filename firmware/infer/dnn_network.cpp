// Runs a network with OpenCV's dnn on one core. The only file that depends on it.
#include <algorithm>
#include <exception>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/dnn.hpp>

#include "infer/network_library.h"

namespace ruffini {
namespace {

class DnnNetwork : public Network {
 public:
  explicit DnnNetwork(cv::dnn::Net net) : net_(std::move(net)) {}

  bool infer(const FrameView& frame, std::span<float> out) override {
    try {
      const cv::Mat picture(frame.height, frame.width, CV_8UC3, const_cast<uint8_t*>(frame.data),
                            static_cast<size_t>(frame.stride));
      cv::dnn::blobFromImage(picture, blob_);  // (1, 3, h, w) float, B G R, 0 to 255
      net_.setInput(blob_);
      const cv::Mat said = net_.forward();
      if (said.total() != out.size() || said.type() != CV_32F || !said.isContinuous()) return false;
      std::copy_n(said.ptr<float>(), out.size(), out.begin());
      return true;
    } catch (const std::exception&) {  // thrown by OpenCV, or for sizes beyond memory
      return false;
    }
  }

 private:
  cv::dnn::Net net_;
  cv::Mat blob_;
};

int ignore_error(int, const char*, const char*, const char*, int, void*) { return 0; }

}  // namespace
}  // namespace ruffini

extern "C" ruffini::Network* ruffini_open_network(const char* path) {
  cv::setNumThreads(1);                      // the frame path has the other cores
  cv::redirectError(ruffini::ignore_error);  // the daemon reports each failure once
  cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
  try {
    cv::dnn::Net net = cv::dnn::readNetFromONNX(path);
    return net.empty() ? nullptr : new ruffini::DnnNetwork(std::move(net));
  } catch (const std::exception&) {
    return nullptr;
  }
}

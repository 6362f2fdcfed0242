// Pictures of a folder. PNG and JPEG are decoded here, so that a recording needs neither OpenCV nor the hundreds of
// libraries that its readers load; other kinds by libruffini_pictures.so.
#pragma once

#include <filesystem>
#include <memory>

#include "base/result.h"
#include "capture/pictures.h"

namespace ruffini {

// Loads libruffini_pictures.so; nullptr if it cannot be loaded.
[[nodiscard]] PicturesOpener* load_picture_reader();
// What to say then (kUnavailable).
[[nodiscard]] Error no_picture_reader();

// The images of a folder, sorted by name; nullptr if there are none. Errors: no_picture_reader().
[[nodiscard]] Result<std::unique_ptr<Pictures>> open_folder(const std::filesystem::path& folder);

}  // namespace ruffini

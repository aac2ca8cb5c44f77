"""What `scene_gt_info.json`, masks and target lists say, made from ground truth, models and depth."""

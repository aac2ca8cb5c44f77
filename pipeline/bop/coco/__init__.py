"""2D detection and segmentation in COCO's form: annotations, results and measures."""

"""What users bring: photos, videos, GPS tags, poses that are known before."""

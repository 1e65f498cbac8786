# make dist && docker build -t shuttle-marl .
FROM python:3.13-slim
# For instance [train], for training with PyTorch.
ARG EXTRAS=
COPY dist/*.whl /tmp/
RUN pip install --no-cache-dir "$(echo /tmp/*.whl)$EXTRAS" && rm /tmp/*.whl && useradd --create-home --home-dir /shuttle player
USER player
WORKDIR /shuttle
ENTRYPOINT ["shuttle-marl"]
CMD ["league", "--matches", "200"]
